// Loads a .splatv file with gsplat.js and prints what it holds, as JSON.
import fs from 'node:fs';
import * as SPLAT from 'gsplat';

// gsplat.js reads files through the browser's FileReader
globalThis.FileReader = class {
    readAsArrayBuffer(file) {
        file.arrayBuffer().then((buffer) => {
            this.result = buffer;
            this.onload?.({ target: this });
            this.onloadend?.({ target: this });
        });
    }
};
const file = new File([fs.readFileSync(process.argv[2])], 'scene.splatv');
const scene = new SPLAT.Scene();
const camera = new SPLAT.Camera();
const splatv = await SPLAT.SplatvLoader.LoadFromFileAsync(file, scene, camera);
const data = splatv.data;
const texture = data.data;
const float = new Float32Array(texture.buffer, texture.byteOffset, texture.length);
const means = [];
for (let i = 0; i < data.vertexCount; i++) means.push([float[16 * i], float[16 * i + 1], float[16 * i + 2]]);
const bounds = [0, 1, 2].map((k) => means.reduce(([a, b], m) => [Math.min(a, m[k]), Math.max(b, m[k])], [Infinity, -Infinity]));
console.log(JSON.stringify({ splats: data.vertexCount, width: data.width, height: data.height, bounds, first: means.slice(0, 4) }));
