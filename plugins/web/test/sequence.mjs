// node sequence.mjs GRAPH FRAMES OUT: denoise the frames of a demo folder in Node; pictures as
// float32, one file each.
import { readFile, writeFile } from 'node:fs/promises';
import { createRequire } from 'node:module';
import { Denoiser } from '../stillray.js';

const ort = createRequire(import.meta.url)('onnxruntime-node');
const [graph, frames, out] = process.argv.slice(2);
const { width, height, count, buffers } = JSON.parse(await readFile(`${frames}/sequence.json`));
const denoiser = await Denoiser.load(ort, graph, ['cpu']);
for (let index = 0; index < count; index++) {
  const data = await readFile(`${frames}/${index}.f32`);
  const values = new Float32Array(data.buffer, data.byteOffset, data.byteLength / 4);
  const frame = { width, height };
  let start = 0;
  for (const [name, channels] of Object.entries(buffers)) {
    const end = start + width * height * channels;
    frame[name] = values.slice(start, end);
    start = end;
  }
  const before = performance.now();
  const picture = await denoiser.denoise(frame);
  console.log((performance.now() - before).toFixed(1));
  await writeFile(`${out}/${index}.f32`, new Uint8Array(picture.buffer, picture.byteOffset, 4 * picture.length));
}
await denoiser.dispose();
