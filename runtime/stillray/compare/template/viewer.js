// The page's state, its controls, keyboard and pointer.

const find = (id) => document.getElementById(id);
const data = JSON.parse(find("data").textContent);
const { width, height } = data;
const count = width * height;
const reference = data.labels.length > data.images ? data.images : null;
const canvas = find("view");
const stage = find("stage");
const context = canvas.getContext("2d", { alpha: false });
const LAYOUTS = ["slider", "pair", "all"];
const MODES = ["image", "absolute", "relative", "signed", "flip"];
const CHANNELS = ["rgb", "red", "green", "blue", "luminance", "alpha"];
const FRAMES_PER_SECOND = 12;

const startExposure = (frame) => Math.round(frame.exposure * 10) / 10;
const state = {
  layout: "slider",
  mode: "image",
  left: 0,
  right: data.labels.length > 1 ? 1 : 0,
  split: 0.5,
  exposure: startExposure(data.frames.find((frame) => frame.has_reference) ?? data.frames[0]),
  ranges: Object.fromEntries(Object.entries(MAPS).map(([mode, map]) => [mode, map.range])),
  base: reference ?? data.labels.length - 1, // what errors are differences from
  layer: 0,
  channel: "rgb",
  transform: "power",
  frame: 0,
  average: "mean",
  place: makePlace(width, height),
  hover: null, // image pixel under the pointer, and the pane
  picked: null, // image pixel that was clicked
  playing: null,
};
const frame = () => data.frames[state.frame];
const fillPixel = makePixelTable(
  find("pixel"),
  data.labels,
  data.labels.length > 1,
  data.frames.some((each) => each.has_flip.some(Boolean)),
);

// ---- pictures -------------------------------------------------------------------------------

const isNeeded = (name) => name === "cube" || name.split("-")[1] === String(state.frame);
const get = makeStore(width, height, isNeeded, schedule, (error) => {
  console.error(error);
  say(
    "DecompressionStream" in window
      ? `The pixels cannot be read: ${error.message}`
      : "This browser is too old to unpack the pixels: it has no DecompressionStream.",
  );
});
const radiance = (image) => get(`radiance-${state.frame}-${image}${state.layer ? `-${state.layer}` : ""}`);
const shadedPictures = new Map(); // image -> canvas, and what it shows

function say(text) {
  find("message").textContent = text;
  find("message").hidden = !text;
}

function isInFile(image) {
  if (image === reference && !frame().has_reference) return false;
  return state.layer === 0 || frame().layers[image][state.layer - 1];
}

function isThere(image) {
  const { mode, channel, base } = state;
  if (!isInFile(image)) return false;
  if (mode === "image") return channel !== "alpha" || frame().has_alpha[image];
  if (mode !== "flip") return isInFile(base);
  return state.layer === 0 && frame().has_reference && (image === reference || frame().has_flip[image]);
}

// Null until the table of the view transform is unpacked.
let cube = null;
function display() {
  if (state.transform === "aces" && !cube) {
    const bytes = get("cube");
    if (!bytes) return null;
    cube = makeCube(bytes, data.transform);
  }
  return makeDisplay(state.transform, state.exposure, cube);
}

// Draws the image as it is, or one channel of it; whether its pixels are there.
function shadeAsItIs(image, out) {
  const { channel } = state;
  if (channel === "alpha") {
    const steps = get(`alpha-${state.frame}-${image}`);
    if (steps) shadeAlpha(steps, out);
    return Boolean(steps);
  }
  const [codes, show] = [radiance(image), display()];
  if (!codes || !show) return false;
  if (channel === "rgb") shadeImage(codes, show, out);
  else shadeChannel(codes, channel, show, out);
  return true;
}

// The same of an error map.
function shadeAsError(image, range, out) {
  const { mode, base } = state;
  if (mode === "flip") {
    const steps = image === reference ? new Uint8Array(count) : get(`flip-${state.frame}-${image}`);
    if (steps) shadeFlip(steps, range, out);
    return Boolean(steps);
  }
  const [codes, wanted] = [radiance(image), radiance(base)];
  if (!codes || !wanted) return false;
  shadeErrors(mode, codes, wanted, state.exposure, RELATIVE_FLOOR / 2 ** frame().exposure, range, out);
  return true;
}

// The image as it is to be shown; null until its pixels are there, undefined where it never is.
function shaded(image) {
  const { mode } = state;
  if (!isThere(image)) return undefined;
  const range = state.ranges[mode];
  const exposed = mode === "relative" || mode === "flip" || state.exposure;
  const look = mode === "image" ? [state.channel, state.transform] : [state.base];
  const key = [state.frame, state.layer, mode, exposed, range, ...look].join();
  let known = shadedPictures.get(image);
  if (known?.key === key) return known.picture;
  if (!known) {
    const picture = document.createElement("canvas");
    [picture.width, picture.height] = [width, height];
    const surface = picture.getContext("2d", { alpha: false });
    known = { picture, surface, pixels: surface.createImageData(width, height) };
    shadedPictures.set(image, known);
  }
  const out = new Uint32Array(known.pixels.data.buffer);
  if (!(mode === "image" ? shadeAsItIs(image, out) : shadeAsError(image, range, out))) return null;
  known.surface.putImageData(known.pixels, 0, 0);
  known.key = key;
  return known.picture;
}

// ---- drawing --------------------------------------------------------------------------------

let scheduled = false;
let panes = [];
let scale = 1; // screen pixels an image pixel, as drawn last
let drawnFrame = null;
const ratio = () => window.devicePixelRatio || 1;

function schedule() {
  if (scheduled) return;
  scheduled = true;
  requestAnimationFrame(() => {
    scheduled = false;
    draw();
  });
}

function draw() {
  const box = stage.getBoundingClientRect();
  const size = [Math.round(box.width * ratio()), Math.round(box.height * ratio())];
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
  const shown = state.layout === "all" ? data.labels.map((_, i) => i) : [state.left, state.right];
  panes = layPanes(state.layout, shown, state.split, ...size, width / height);
  scale = state.place.scale ?? fitScale(panes[0], width, height);
  const pictures = panes.map((pane) => shaded(pane.image));
  const isBusy = pictures.includes(null);
  stage.setAttribute("aria-busy", String(isBusy));
  if (!isBusy) {
    // all at once: a frame never shows beside another
    context.fillStyle = "#161616";
    context.fillRect(0, 0, canvas.width, canvas.height);
    panes.forEach((pane, index) => {
      if (pictures[index]) drawPane(context, pane, pictures[index], state.place, scale);
      for (const pixel of [state.picked, state.hover?.pane === index ? null : state.hover?.pixel]) {
        if (pixel && (pixel === state.picked || state.layout !== "slider")) {
          drawMark(context, pane, state.place, scale, pixel);
        }
      }
    });
    say(pictures.includes(undefined) ? missing(pictures) : "");
    drawnFrame = state.frame;
  }
  drawOverlays();
  showPixel();
}

function missing(pictures) {
  const without = panes.filter((_, i) => pictures[i] === undefined).map((pane) => pane.image);
  const { mode, base, layer } = state;
  const needed = mode === "image" ? without : [...without, base];
  if (needed.includes(reference) && !frame().has_reference) return "This frame has no reference.";
  const bare = needed.filter((image) => !isInFile(image));
  const names = (images) => [...new Set(images.map((image) => data.labels[image]))].join(", ");
  if (bare.length) return `${names(bare)}: no layer ${data.layers[layer]}.`;
  if (mode === "image") return `${names(without)}: no alpha.`;
  return layer
    ? "FLIP is of the color alone."
    : `No FLIP of ${names(without)}: it has NaN or infinite pixels.`;
}

function drawOverlays() {
  const css = (pixels) => `${pixels / ratio()}px`;
  const isSlider = state.layout === "slider";
  const isAll = state.layout === "all";
  find("divider").hidden = !isSlider;
  find("divider").style.left = `${100 * state.split}%`;
  find("divider").setAttribute("aria-valuenow", Math.round(100 * state.split));
  find("pick-left").hidden = find("pick-right").hidden = isAll;
  const second = panes[1] ?? panes[0];
  Object.assign(find("pick-right").style, {
    left: isSlider ? "auto" : css(second.x),
    right: isSlider ? "0" : "auto",
    top: css(second.y),
  });
  find("names").hidden = !isAll;
  if (isAll) {
    find("names").replaceChildren(
      ...panes.map((pane) => {
        const name = element("span", data.labels[pane.image]);
        Object.assign(name.style, { left: css(pane.x), top: css(pane.y), maxWidth: css(pane.width) });
        return name;
      }),
    );
  }
  document.body.style.setProperty("--stacked", isSlider ? 1 : panes.length);
  find("zoom-value").textContent = `${Math.round(100 * scale)} %`;
  find("legend").hidden = state.mode === "image";
  const shown = isAll ? "All images" : `Left: ${data.labels[state.left]}. Right: ${data.labels[state.right]}`;
  canvas.setAttribute("aria-label", `${shown}. ${modeName()}.`);
}

const modeName = () =>
  document.querySelector(`input[name=mode][value=${state.mode}]`).parentElement.textContent.trim();

function drawLegend() {
  if (state.mode === "image") return;
  const { ramp, ranges } = MAPS[state.mode];
  const range = state.ranges[state.mode];
  const surface = find("ramp").getContext("2d");
  const pixels = surface.createImageData(256, 1);
  new Uint32Array(pixels.data.buffer).set(ramp);
  surface.putImageData(pixels, 0, 0);
  const isSigned = state.mode === "signed";
  find("ramp-low").textContent = isSigned ? `−${range}` : "0";
  find("ramp-high").textContent = isSigned ? `+${range}` : String(range);
  find("range").replaceChildren(
    ...ranges.map((value) => {
      const option = element("option", String(value), { value });
      option.selected = value === range;
      return option;
    }),
  );
}

// ---- one pixel ------------------------------------------------------------------------------

function showPixel() {
  const pixel = state.picked ?? state.hover?.pixel;
  if (!pixel) {
    find("pixel-title").textContent = "Pixel: point at one, click to keep it";
    fillPixel(null);
    return;
  }
  const [x, y] = [pixel.x, pixel.y].map((at, axis) => at * data.downscale + data.origin[axis]);
  const cell = data.downscale > 1 ? `, mean of ${data.downscale} × ${data.downscale}` : "";
  find("pixel-title").textContent = `Pixel ${x}, ${y}${cell}${state.picked ? ", kept" : ""}`;
  const at = pixel.y * width + pixel.x;
  const wanted = isInFile(state.base) && radiance(state.base);
  const show = display();
  fillPixel(
    data.labels.map((_, image) => {
      if (!isInFile(image)) return {};
      const codes = radiance(image);
      if (!codes) return {};
      const found = [0, 1, 2].map((channel) => codes[channel * count + at]);
      const figures = found.map((code) => HALF[code]);
      if (wanted && image !== state.base) {
        figures.push(ERRORS.absolute(codes, wanted, count, at, 1));
        figures.push(
          ERRORS.relative(codes, wanted, count, at, 1, RELATIVE_FLOOR / 2 ** frame().exposure),
        );
        const isFlip = state.base === reference && state.layer === 0 && frame().has_flip[image];
        const flip = isFlip && get(`flip-${state.frame}-${image}`);
        if (flip) figures.push(flip[at] / 255);
      }
      return { figures, colour: show ? `rgb(${show(...found).join(" ")})` : "transparent" };
    }),
  );
}

// ---- changes --------------------------------------------------------------------------------

function setExposure(stops) {
  const limited = Math.min(Math.max(Math.round(stops * 10) / 10, -12), 12);
  state.exposure = limited;
  find("exposure").value = limited;
  find("exposure").setAttribute("aria-valuetext", `${signed(limited, 1)} stops`);
  find("exposure-value").textContent = signed(limited, 1);
  schedule();
}

function setChoice(name, value) {
  state[name] = value;
  document.querySelector(`input[name=${name}][value=${value}]`).checked = true;
  if (name === "mode") drawLegend();
  if (name === "average") showFigures();
  schedule();
}

function setImage(side, image) {
  if (image >= data.labels.length) return;
  state[side] = image;
  find(side).value = image;
  schedule();
}

function setSplit(split) {
  state.split = Math.min(Math.max(split, 0), 1);
  schedule();
}

function setFrame(index) {
  state.frame = (index + data.frames.length) % data.frames.length;
  find("frame").value = state.frame;
  const text = `frame ${frame().number} (${state.frame + 1} of ${data.frames.length})`;
  find("frame-value").textContent = text;
  find("frame").setAttribute("aria-valuetext", text);
  showFigures();
  schedule();
}

function showFigures() {
  const isMean = state.average === "mean" && data.frames.length > 1;
  fillMetrics(find("metrics"), data, isMean ? data.means : frame().rows);
}

function setPlaying(playing) {
  clearInterval(state.playing);
  // a frame that is still being unpacked is waited for
  const step = () => drawnFrame === state.frame && setFrame(state.frame + 1);
  state.playing = playing ? setInterval(step, 1000 / FRAMES_PER_SECOND) : null;
  find("play").textContent = playing ? "Stop" : "Play";
}

// about a screen point, so that what lies there stays there
function zoomTo(wanted, x, y) {
  const pane = panes.find((each) => x >= each.from && x < each.to && y >= each.y && y < each.y + each.height) ?? panes[0];
  const next = Math.min(Math.max(wanted, LEAST_ZOOM), MOST_ZOOM);
  const { place } = state;
  for (const [axis, at] of [["x", x - pane.x - pane.width / 2], ["y", y - pane.y - pane.height / 2]]) {
    place[axis] += at / scale - at / next;
  }
  place.scale = next;
  keepInside();
}

function zoomMiddle(wanted) {
  const [pane] = panes;
  zoomTo(wanted, pane.x + pane.width / 2, pane.y + pane.height / 2);
}

function fit() {
  Object.assign(state.place, makePlace(width, height));
  schedule();
}

function move(right, down) {
  state.place.scale ??= scale;
  state.place.x -= right / scale;
  state.place.y -= down / scale;
  keepInside();
}

function keepInside() {
  state.place.x = Math.min(Math.max(state.place.x, 0), width);
  state.place.y = Math.min(Math.max(state.place.y, 0), height);
  schedule();
}

function pick(pixel) {
  const same = pixel && state.picked && pixel.x === state.picked.x && pixel.y === state.picked.y;
  state.picked = same ? null : pixel;
  schedule();
}

// ---- pointer --------------------------------------------------------------------------------

const pointers = new Map(); // pointer -> screen point
let dragged = 0;

const screenPoint = (event) => {
  const box = canvas.getBoundingClientRect();
  return { x: (event.clientX - box.left) * ratio(), y: (event.clientY - box.top) * ratio() };
};

function pixelUnder(point) {
  const index = panes.findIndex((p) => point.x >= p.from && point.x < p.to && point.y >= p.y && point.y < p.y + p.height);
  const pixel = index >= 0 && pixelAt(panes[index], state.place, scale, point.x, point.y, width, height);
  return pixel ? { pane: index, pixel } : null;
}

canvas.addEventListener("pointerdown", (event) => {
  canvas.setPointerCapture(event.pointerId);
  pointers.set(event.pointerId, screenPoint(event));
  if (pointers.size === 1) dragged = 0;
});

canvas.addEventListener("pointermove", (event) => {
  const point = screenPoint(event);
  const before = pointers.get(event.pointerId);
  if (before) {
    const others = [...pointers].filter(([id]) => id !== event.pointerId).map(([, other]) => other);
    if (others.length === 1) {
      const [other] = others;
      const spread = (from) => Math.max(Math.hypot(from.x - other.x, from.y - other.y), 1);
      move((point.x - before.x) / 2, (point.y - before.y) / 2);
      zoomTo((scale * spread(point)) / spread(before), (point.x + other.x) / 2, (point.y + other.y) / 2);
      scale = state.place.scale; // two pointers may move before the next drawing
    } else {
      move(point.x - before.x, point.y - before.y);
    }
    dragged += Math.abs(point.x - before.x) + Math.abs(point.y - before.y);
    pointers.set(event.pointerId, point);
  }
  state.hover = pixelUnder(point);
  schedule();
});

function endPointer(event) {
  if (!pointers.delete(event.pointerId) || event.type !== "pointerup") return;
  const under = pixelUnder(screenPoint(event));
  if (under && dragged < 4 * ratio()) pick(under.pixel);
}
canvas.addEventListener("pointerup", endPointer);
canvas.addEventListener("pointercancel", endPointer);
canvas.addEventListener("pointerleave", () => {
  state.hover = null;
  schedule();
});

stage.addEventListener(
  "wheel",
  (event) => {
    if (event.target.closest("select")) return;
    event.preventDefault();
    const point = screenPoint(event);
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 30 : 1;
    zoomTo(scale * 2 ** ((-event.deltaY * lines) / 300), point.x, point.y);
    scale = state.place.scale;
  },
  { passive: false },
);

const divider = find("divider");
divider.addEventListener("pointerdown", (event) => divider.setPointerCapture(event.pointerId));
divider.addEventListener("pointermove", (event) => {
  if (divider.hasPointerCapture(event.pointerId)) setSplit(screenPoint(event).x / canvas.width);
});

// ---- keyboard -------------------------------------------------------------------------------

divider.addEventListener("keydown", (event) => {
  const step = event.shiftKey ? 0.1 : 0.01;
  const to = {
    ArrowLeft: state.split - step,
    ArrowDown: state.split - step,
    ArrowRight: state.split + step,
    ArrowUp: state.split + step,
    PageDown: state.split - 0.1,
    PageUp: state.split + 0.1,
    Home: 0,
    End: 1,
  }[event.key];
  if (to === undefined || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  event.stopPropagation();
  setSplit(to);
});

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

stage.addEventListener("keydown", (event) => {
  if (event.target !== stage || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key in ARROWS) {
    const [right, down] = ARROWS[event.key];
    const far = event.shiftKey ? 10 : 1;
    if (state.picked) {
      state.picked = {
        x: Math.min(Math.max(state.picked.x + right * far, 0), width - 1),
        y: Math.min(Math.max(state.picked.y + down * far, 0), height - 1),
      };
      schedule();
    } else move(-right * far * 40, -down * far * 40);
  } else if (event.key === "Enter") {
    const x = Math.min(Math.floor(state.place.x), width - 1);
    pick({ x, y: Math.min(Math.floor(state.place.y), height - 1) });
  } else return;
  event.preventDefault();
});

const next = (list, value) => list[(list.indexOf(value) + 1) % list.length];
const modes = () =>
  MODES.filter((mode) => (mode === "flip" ? reference !== null : mode === "image" || data.labels.length > 1));
const KEYS = {
  x: () => {
    const { left, right } = state;
    setImage("left", right);
    setImage("right", left);
  },
  l: () => setChoice("layout", next(LAYOUTS, state.layout)),
  c: () => setLook("channel", next(channels, state.channel)),
  v: () => setLook("transform", next(transforms, state.transform)),
  m: () => setChoice("mode", next(modes(), state.mode)),
  e: (event) => setExposure(state.exposure + (event.shiftKey ? -0.5 : 0.5)),
  0: () => setExposure(startExposure(frame())),
  "+": () => zoomMiddle(scale * Math.SQRT2),
  "=": () => zoomMiddle(scale * Math.SQRT2),
  "-": () => zoomMiddle(scale / Math.SQRT2),
  f: fit,
  z: () => zoomMiddle(1),
  escape: () => pick(null),
  ",": () => setFrame(state.frame - 1),
  ".": () => setFrame(state.frame + 1),
  " ": () => data.frames.length > 1 && setPlaying(!state.playing),
  "?": () => find("help").showModal(),
};

document.addEventListener("keydown", (event) => {
  if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey) return;
  // a select finds its options by letters, and controls use the space bar themselves
  if (event.target.closest("select, dialog")) return;
  if (event.key === " " && event.target.closest("button, input")) return;
  const digit = /^Digit([1-9])$/.exec(event.code);
  if (digit) setImage(event.shiftKey ? "right" : "left", Number(digit[1]) - 1);
  else if (Object.hasOwn(KEYS, event.key.toLowerCase())) KEYS[event.key.toLowerCase()](event);
  else return;
  event.preventDefault();
});

// ---- controls -------------------------------------------------------------------------------

for (const name of ["layout", "mode", "average"]) {
  for (const input of document.querySelectorAll(`input[name=${name}]`)) {
    input.addEventListener("change", () => setChoice(name, input.value));
  }
}
for (const side of ["left", "right"]) {
  find(side).append(...data.labels.map((label, image) => element("option", label, { value: image })));
  find(side).addEventListener("change", () => setImage(side, Number(find(side).value)));
  setImage(side, state[side]);
}
const channels = CHANNELS.filter(
  (channel) => channel !== "alpha" || data.frames.some((each) => each.has_alpha.some(Boolean)),
);
const transforms = ["power", "srgb", ...(data.transform ? ["aces"] : [])];
const NAMES = { rgb: "RGB", power: "Power 2.2", srgb: "sRGB", aces: data.transform?.name };
const named = (value) => NAMES[value] ?? value[0].toUpperCase() + value.slice(1);

function setLook(name, value) {
  state[name] = value;
  find(name).value = value;
  schedule();
}

for (const [name, options] of [
  ["channel", channels.map((channel) => [channel, named(channel)])],
  ["transform", transforms.map((transform) => [transform, named(transform)])],
  ["layer", data.layers.map((layer, index) => [index, layer])],
  ["base", data.labels.map((label, index) => [index, label])],
]) {
  find(name).append(...options.map(([value, text]) => element("option", text, { value })));
  const isNumber = typeof options[0][0] === "number";
  find(name).addEventListener("change", () => {
    setLook(name, isNumber ? Number(find(name).value) : find(name).value);
  });
  setLook(name, state[name]);
}
find("layer-choice").hidden = data.layers.length < 2;
find("base-choice").hidden = data.labels.length < 3 && reference !== null;
find("exposure").addEventListener("input", () => setExposure(Number(find("exposure").value)));
find("exposure-reset").addEventListener("click", () => KEYS[0]());
find("zoom-fit").addEventListener("click", fit);
find("zoom-one").addEventListener("click", KEYS.z);
find("help-open").addEventListener("click", KEYS["?"]);
find("range").addEventListener("change", () => {
  state.ranges[state.mode] = Number(find("range").value);
  drawLegend();
  schedule();
});
find("frame").max = data.frames.length - 1;
find("frame").addEventListener("input", () => setFrame(Number(find("frame").value)));
find("play").addEventListener("click", () => setPlaying(!state.playing));

const isSequence = data.frames.length > 1;
find("time").hidden = find("average").hidden = !isSequence;
for (const each of document.querySelectorAll(".of-time")) each.hidden = !isSequence;
find("mode").hidden = data.labels.length < 2;
find("flip-choice").hidden = reference === null;
find("figures").hidden = data.metrics.length === 0;
const measured = data.frames.filter((each) => each.has_reference).length;
find("notes").textContent = notes(data);
find("mean-name").textContent = `Mean of ${measured} ${measured === 1 ? "frame" : "frames"}`;
document.body.style.setProperty("--aspect", width / height);
setExposure(state.exposure);
setFrame(0);
new ResizeObserver(schedule).observe(stage);
