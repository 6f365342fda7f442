// From radiance to what the screen shows: exposure and tone curve, or an error map in colour.

const GAMMA = 2.2;
const RELATIVE_FLOOR = 0.01; // of exposed radiance, as in the metrics: black has no relative error
// magma (Smith, van der Walt 2015, CC0), sixteenths
const MAGMA = (
  "000004 0a0822 1d1147 36106b 51127c 6a1c81 832681 9c2e7f b73779 " +
  "d0416f e75263 f56b5c fc8961 fea772 fec488 fde2a3 fcfdbf"
).split(" ");
const SIGNED = "c9ecff 6db9f2 2f7fd6 1c4270 121212 6e3a17 d9692a f5ad62 ffe9c7".split(" ");
// not finite: colours that neither images nor ramps are likely to hold
const BAD_IN_IMAGE = pack(255, 0, 255);
const BAD_IN_MAP = pack(0, 255, 0);

function pack(red, green, blue) {
  return (0xff000000 | (blue << 16) | (green << 8) | red) >>> 0;
}

function makeRamp(anchors) {
  const colours = anchors.map((hex) => [0, 2, 4].map((at) => parseInt(hex.slice(at, at + 2), 16)));
  const ramp = new Uint32Array(256);
  for (let step = 0; step < 256; step++) {
    const place = (step / 255) * (colours.length - 1);
    const low = Math.min(Math.floor(place), colours.length - 2);
    const mixed = colours[low].map((value, channel) =>
      Math.round(value + (colours[low + 1][channel] - value) * (place - low)),
    );
    ramp[step] = pack(...mixed);
  }
  return ramp;
}

// What the error maps are: the colours, the full scales to choose from, the scale to begin with.
const MAPS = {
  absolute: { ramp: makeRamp(MAGMA), ranges: [0.02, 0.05, 0.1, 0.25, 0.5, 1, 2], range: 0.25 },
  relative: { ramp: makeRamp(MAGMA), ranges: [0.05, 0.1, 0.25, 0.5, 1, 2], range: 0.5 },
  signed: { ramp: makeRamp(SIGNED), ranges: [0.02, 0.05, 0.1, 0.25, 0.5, 1, 2], range: 0.25 },
  flip: { ramp: makeRamp(MAGMA), ranges: [0.1, 0.25, 0.5, 1], range: 0.5 },
};

// IEC 61966-2-1
const srgb = (light) => (light <= 0.0031308 ? 12.92 * light : 1.055 * light ** (1 / 2.4) - 0.055);
const CURVES = { power: (light) => light ** (1 / GAMMA), srgb };

// eight bits for every half float, by one curve for all channels
const displayTable = (() => {
  const table = new Uint8Array(65536);
  let made = null;
  return (stops, curve = "power") => {
    if (made !== `${curve} ${stops}`) {
      const gain = 2 ** stops;
      for (let code = 0; code < 65536; code++) {
        table[code] = Math.round(255 * CURVES[curve](Math.min(Math.max(HALF[code] * gain, 0), 1)));
      }
      made = `${curve} ${stops}`;
    }
    return table;
  };
})();

// A view transform that mixes channels: a cube of eight-bit colours, read between its nodes. What
// view_transform.py made; `steepness` and `stops` say where the nodes lie.
function makeCube(bytes, { nodes, steepness, stops }) {
  const plane = nodes ** 3;
  const last = nodes - 1;
  let made = null;
  const places = new Float32Array(65536);
  const colour = new Float64Array(3);
  return (exposure) => {
    if (made !== exposure) {
      const gain = steepness * 2 ** exposure;
      for (let code = 0; code < 65536; code++) {
        const at = (last / stops) * Math.log2(Math.max(HALF[code] * gain, 0) + 1);
        places[code] = Math.min(at, last);
      }
      made = exposure;
    }
    return (red, green, blue) => {
      const x = Math.min(Math.floor(places[red]), last - 1);
      const y = Math.min(Math.floor(places[green]), last - 1);
      const z = Math.min(Math.floor(places[blue]), last - 1);
      const [right, down, far] = [places[red] - x, places[green] - y, places[blue] - z];
      colour.fill(0);
      for (let near = 0; near < 8; near++) {
        const [i, j, k] = [near >> 2, (near >> 1) & 1, near & 1];
        const weight = (i ? right : 1 - right) * (j ? down : 1 - down) * (k ? far : 1 - far);
        const node = ((x + i) * nodes + y + j) * nodes + z + k;
        for (let channel = 0; channel < 3; channel++) {
          colour[channel] += weight * bytes[channel * plane + node];
        }
      }
      for (let channel = 0; channel < 3; channel++) colour[channel] = Math.round(colour[channel]);
      return colour;
    };
  };
}

// What gives eight bits each of red, green and blue for the codes of one pixel: good until it is
// asked again. `table`, where every channel goes its own way.
function makeDisplay(curve, stops, cube) {
  if (curve === "aces") return cube(stops);
  const table = displayTable(stops, curve);
  return Object.assign((...codes) => codes.map((code) => table[code]), { table });
}

const LUMINANCE = [0.2126, 0.7152, 0.0722]; // Rec. 709

const isBad = (a, b, c) => {
  const all = 0x7c00; // the exponent of NaN and infinity
  return (a & all) === all || (b & all) === all || (c & all) === all;
};

function shadeImage(codes, display, out) {
  const { table } = display;
  const count = out.length;
  for (let i = 0; i < count; i++) {
    const red = codes[i];
    const green = codes[count + i];
    const blue = codes[2 * count + i];
    if (isBad(red, green, blue)) out[i] = BAD_IN_IMAGE;
    else if (table) out[i] = 0xff000000 | (table[blue] << 16) | (table[green] << 8) | table[red];
    else out[i] = pack(...display(red, green, blue));
  }
}

// One channel, or luminance, as grey.
function shadeChannel(codes, channel, display, out) {
  const count = out.length;
  const toHalf = channel === "luminance" ? nearestHalf : null;
  for (let i = 0; i < count; i++) {
    const found = [codes[i], codes[count + i], codes[2 * count + i]];
    if (isBad(...found)) out[i] = BAD_IN_IMAGE;
    else {
      const grey = toHalf
        ? toHalf(LUMINANCE.reduce((sum, share, at) => sum + share * HALF[found[at]], 0))
        : found["red green blue".split(" ").indexOf(channel)];
      out[i] = pack(...display(grey, grey, grey));
    }
  }
}

// The code of the half float nearest to a value; below 0 counts as 0.
function nearestHalf(value) {
  let [low, high] = [0, 0x7bff];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (HALF[middle] < value) low = middle + 1;
    else high = middle;
  }
  return low > 0 && value - HALF[low - 1] < HALF[low] - value ? low - 1 : low;
}

// Coverage, in steps of 1/255: no light, so neither exposed nor curved.
function shadeAlpha(steps, out) {
  for (let i = 0; i < out.length; i++) out[i] = pack(steps[i], steps[i], steps[i]);
}

// One figure a pixel, the mean over the channels; not a number where a pixel is not finite.
const ERRORS = {
  absolute(codes, wanted, count, i, gain) {
    let sum = 0;
    for (let at = i; at < 3 * count; at += count) sum += Math.abs(HALF[codes[at]] - HALF[wanted[at]]);
    return (sum * gain) / 3;
  },
  relative(codes, wanted, count, i, gain, floor) {
    let sum = 0;
    for (let at = i; at < 3 * count; at += count) {
      const right = HALF[wanted[at]];
      sum += Math.abs(HALF[codes[at]] - right) / (Math.abs(right) + floor);
    }
    return sum / 3;
  },
  signed(codes, wanted, count, i, gain) {
    let sum = 0;
    for (let at = i; at < 3 * count; at += count) sum += HALF[codes[at]] - HALF[wanted[at]];
    return (sum * gain) / 3;
  },
};

// `floor` is in the units of the file
function shadeErrors(mode, codes, wanted, stops, floor, range, out) {
  const { ramp } = MAPS[mode];
  const error = ERRORS[mode];
  const gain = 2 ** stops;
  const count = out.length;
  const [scale, zero] = mode === "signed" ? [127.5 / range, 127.5] : [255 / range, 0];
  for (let i = 0; i < count; i++) {
    const value = error(codes, wanted, count, i, gain, floor) * scale + zero;
    out[i] = Number.isFinite(value)
      ? ramp[Math.max(0, Math.min(255, Math.round(value)))]
      : BAD_IN_MAP;
  }
}

function shadeFlip(steps, range, out) {
  const { ramp } = MAPS.flip;
  for (let i = 0; i < out.length; i++) out[i] = ramp[Math.min(255, Math.round(steps[i] / range))];
}
