// Prints what the Khronos validator says of a .glb file, as JSON.
import fs from 'node:fs';
import validator from 'gltf-validator';

const bytes = new Uint8Array(fs.readFileSync(process.argv[2]));
const report = await validator.validateBytes(bytes, { maxIssues: 1000 });
console.log(JSON.stringify(report));
