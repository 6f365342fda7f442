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

// eight bits for every half float
const displayTable = (() => {
  const table = new Uint8Array(65536);
  let made = null;
  return (stops) => {
    if (made !== stops) {
      const gain = 2 ** stops;
      for (let code = 0; code < 65536; code++) {
        const light = Math.min(Math.max(HALF[code] * gain, 0), 1);
        table[code] = Math.round(255 * light ** (1 / GAMMA));
      }
      made = stops;
    }
    return table;
  };
})();

const isBad = (a, b, c) => {
  const all = 0x7c00; // the exponent of NaN and infinity
  return (a & all) === all || (b & all) === all || (c & all) === all;
};

function shadeImage(codes, stops, out) {
  const table = displayTable(stops);
  const count = out.length;
  for (let i = 0; i < count; i++) {
    const red = codes[i];
    const green = codes[count + i];
    const blue = codes[2 * count + i];
    out[i] = isBad(red, green, blue)
      ? BAD_IN_IMAGE
      : 0xff000000 | (table[blue] << 16) | (table[green] << 8) | table[red];
  }
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
