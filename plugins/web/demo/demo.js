// Plays a sequence, noisy beside clean, with the milliseconds of each frame.
import { Denoiser } from './stillray.js';

const wanted = new URLSearchParams(location.search).get('provider') ?? 'wasm';
const element = (id) => document.getElementById(id);
const say = (text) => (element('status').textContent = text);

/** Scene-linear radiance as sRGB bytes. */
function show(canvas, radiance, { width, height }) {
  const pixels = new Uint8ClampedArray(width * height * 4).fill(255);
  for (let i = 0; i < width * height; i++) {
    for (let c = 0; c < 3; c++) {
      const x = Math.min(Math.max(radiance[3 * i + c], 0), 1);
      pixels[4 * i + c] = 255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);
    }
  }
  canvas.width = width;
  canvas.height = height;
  canvas.getContext('2d').putImageData(new ImageData(pixels, width, height), 0, 0);
}

/** A frame's buffers, which lie one after the other in one file of float32. */
async function read(sequence, index) {
  const data = await (await fetch(`frames/${index}.f32`)).arrayBuffer();
  const frame = { width: sequence.width, height: sequence.height };
  let start = 0;
  for (const [name, channels] of Object.entries(sequence.buffers)) {
    const count = frame.width * frame.height * channels;
    frame[name] = new Float32Array(data, 4 * start, count);
    start += count;
  }
  return frame;
}

async function play(denoiser, sequence) {
  const milliseconds = [];
  const pictures = [];
  denoiser.reset();
  for (let index = 0; index < sequence.count; index++) {
    const frame = await read(sequence, index);
    const start = performance.now();
    const clean = await denoiser.denoise(frame);
    milliseconds.push(performance.now() - start);
    pictures.push(clean);
    show(element('noisy'), frame.color, frame);
    show(element('clean'), clean, frame);
    say(`Frame ${index + 1} of ${sequence.count}, ${milliseconds[index].toFixed(0)} ms (${wanted})`);
  }
  return { milliseconds, pictures };
}

try {
  const bundle = wanted === 'webgpu' ? 'ort.webgpu.bundle.min.mjs' : 'ort.wasm.bundle.min.mjs';
  const ort = await import(`./ort/${bundle}`);
  // one thread where the server does not isolate the page
  ort.env.wasm.numThreads = crossOriginIsolated ? navigator.hardwareConcurrency : 1;
  const sequence = await (await fetch('frames/sequence.json')).json();
  const denoiser = await Denoiser.load(ort, 'model.onnx', [wanted]);
  const again = async () => (window.played = await play(denoiser, sequence));
  element('again').onclick = again;
  await again();
} catch (error) {
  say(`It failed: ${error.message}`);
  window.failed = String(error.stack ?? error);
}
