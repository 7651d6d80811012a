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
// The texture that the player draws from: 16 words a splat, the mean first. (data.positions, which serves
// to sort, has word 3 in place of x in gsplat.js 1.2.9.)
const float = new Float32Array(data.data.buffer, data.data.byteOffset, data.data.length);
const low = [Infinity, Infinity, Infinity];
const high = [-Infinity, -Infinity, -Infinity];
const means = [];
for (let i = 0; i < data.vertexCount; i++) {
    for (let k = 0; k < 3; k++) {
        low[k] = Math.min(low[k], float[16 * i + k]);
        high[k] = Math.max(high[k], float[16 * i + k]);
    }
    if (i % 1000 === 0) means.push(Array.from(float.slice(16 * i, 16 * i + 3)));
}
console.log(JSON.stringify({ splats: data.vertexCount, low, high, means }));
