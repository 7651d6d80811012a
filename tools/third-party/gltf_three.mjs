// Loads a .glb file as a page with three.js does and prints what it holds, as JSON.
import fs from 'node:fs';
import { GLTFLoader } from 'three/examples/jsm/loaders/GLTFLoader.js';
import { GLTFGaussianSplatLoaderExtension } from 'three/examples/jsm/loaders/GLTFGaussianSplatLoaderExtension.js';

globalThis.self ??= globalThis;
const file = fs.readFileSync(process.argv[2]);
const loader = new GLTFLoader();
loader.register((parser) => new GLTFGaussianSplatLoaderExtension(parser));
const gltf = await loader.parseAsync(file.buffer.slice(file.byteOffset, file.byteOffset + file.byteLength), '');
let splats = null;
gltf.scene.traverse((object) => {
    if (object.isGaussianSplat) splats = object;
});
const { position, covariance, color } = splats.splatGeometry.attributes;
const box = splats.splatGeometry.boundingBox;
console.log(JSON.stringify({
    type: splats.type,
    count: position.count,
    min: box.min.toArray(),
    max: box.max.toArray(),
    covariances: Array.from(covariance.array.slice(0, 6 * 100)),
    colors: Array.from(color.array.slice(0, 4 * 100)),
}));
