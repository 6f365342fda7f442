// Pixels out of the page: base64, zlib, then what pixels.py did, undone.

const DECODED_BYTES = 768e6; // of pictures kept decoded; beyond, those unused longest go

// every half float as a number
const HALF = (() => {
  const table = new Float32Array(65536);
  for (let code = 0; code < 65536; code++) {
    const exponent = (code >> 10) & 31;
    const fraction = code & 1023;
    let value;
    if (exponent === 31) value = fraction ? NaN : Infinity;
    else if (exponent) value = (1 + fraction / 1024) * 2 ** (exponent - 15);
    else value = fraction * 2 ** -24;
    table[code] = code & 0x8000 ? -value : value;
  }
  return table;
})();

async function inflate(name) {
  const text = atob(document.getElementById(name).textContent);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// half floats as codes, a plane a channel: red, green, blue
function unpackRadiance(bytes, width, height) {
  const count = width * height;
  const half = 3 * count;
  const codes = new Uint16Array(half);
  for (let row = 0; row < 3 * height; row++) {
    let left = 0;
    for (let i = row * width; i < (row + 1) * width; i++) {
      const folded = (bytes[i] << 8) | bytes[half + i];
      left = (left + ((folded >>> 1) ^ -(folded & 1))) & 0xffff;
      codes[i] = left;
    }
  }
  for (let i = 0; i < count; i++) {
    codes[i] += codes[count + i];
    codes[2 * count + i] += codes[count + i];
  }
  return codes;
}

// errors in steps of 1/255, in place
function unpackMap(bytes, width, height) {
  for (let row = 0; row < height; row++) {
    for (let i = row * width + 1; i < (row + 1) * width; i++) bytes[i] += bytes[i - 1];
  }
  return bytes;
}

// Decoded pictures by name; whoever asks too early is told by `whenDecoded` to ask again. Pictures
// that are needed stay, however many they are.
function makeStore(width, height, isNeeded, whenDecoded, whenFailed) {
  const ready = new Map();
  const waiting = new Set();
  let held = 0;

  async function decode(name) {
    waiting.add(name);
    try {
      const bytes = await inflate(name);
      const kind = name.split("-")[0];
      const unpack = { radiance: unpackRadiance, cube: (plain) => plain }[kind] ?? unpackMap;
      const pixels = unpack(bytes, width, height);
      ready.set(name, pixels);
      held += pixels.byteLength;
      for (const [oldest, gone] of ready) {
        if (held <= DECODED_BYTES) break;
        if (isNeeded(oldest)) continue;
        ready.delete(oldest);
        held -= gone.byteLength;
      }
      whenDecoded();
    } catch (error) {
      whenFailed(error);
    } finally {
      waiting.delete(name);
    }
  }

  return function get(name) {
    const pixels = ready.get(name);
    if (pixels) {
      ready.delete(name); // to the end: used last
      ready.set(name, pixels);
    } else if (!waiting.has(name)) decode(name);
    return pixels;
  };
}
