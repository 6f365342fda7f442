// node sequence.mjs GRAPH FRAMES OUT: denoise the frames of a demo folder in Node; pictures as
// float32, one file each; on standard output milliseconds and seconds of processor time as JSON.
import { readFile, writeFile } from 'node:fs/promises';
import { createRequire } from 'node:module';
import { Denoiser } from '../stillray.js';

const ort = createRequire(import.meta.url)('onnxruntime-node');
const [graph, frames, out] = process.argv.slice(2);
const { width, height, count, buffers } = JSON.parse(await readFile(`${frames}/sequence.json`));
// one thread, for the processor time
const options = { executionProviders: ['cpu'], intraOpNumThreads: 1 };
const denoiser = new Denoiser(ort, await ort.InferenceSession.create(graph, options));
const [milliseconds, processor] = [[], []];
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
  const [before, busy] = [performance.now(), process.cpuUsage()];
  const picture = await denoiser.denoise(frame);
  milliseconds.push(performance.now() - before);
  const spent = process.cpuUsage(busy);
  processor.push((spent.user + spent.system) / 1e6);
  await writeFile(`${out}/${index}.f32`, new Uint8Array(picture.buffer, picture.byteOffset, 4 * picture.length));
}
await denoiser.dispose();
console.log(JSON.stringify({ milliseconds, processor }));
