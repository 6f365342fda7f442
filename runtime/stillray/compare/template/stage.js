// Where images lie on the screen: panes that share one zoom and one place, and how they are drawn.

const MOST_ZOOM = 64; // screen pixels an image pixel, each way
const LEAST_ZOOM = 1 / 16;
const SHARP_FROM = 2; // screen pixels an image pixel: from here on pixels are shown as squares
const GAP = 2; // between panes, screen pixels

// `scale` null: fitted. `x`, `y`: the image point in the middle of every pane.
function makePlace(width, height) {
  return { scale: null, x: width / 2, y: height / 2 };
}

// Panes in screen pixels; of the slider's two, which lie on each other, only parts are seen.
function layPanes(layout, shown, split, width, height, aspect) {
  if (layout === "slider") {
    const cut = Math.round(split * width);
    return [
      { image: shown[0], x: 0, y: 0, width, height, from: 0, to: cut },
      { image: shown[1], x: 0, y: 0, width, height, from: cut, to: width },
    ];
  }
  let columns = 1;
  let best = 0;
  for (let tried = 1; tried <= shown.length; tried++) {
    const rows = Math.ceil(shown.length / tried);
    const size = Math.min(width / tried, (height / rows) * aspect); // width an image would get
    if (size > best) [columns, best] = [tried, size];
  }
  const rows = Math.ceil(shown.length / columns);
  const wide = Math.floor((width - GAP * (columns - 1)) / columns);
  const high = Math.floor((height - GAP * (rows - 1)) / rows);
  return shown.map((image, index) => {
    const x = (index % columns) * (wide + GAP);
    const y = Math.floor(index / columns) * (high + GAP);
    return { image, x, y, width: wide, height: high, from: x, to: x + wide };
  });
}

function fitScale(pane, width, height) {
  return Math.min(pane.width / width, pane.height / height, MOST_ZOOM);
}

// The corner of the image on the screen. Whole pixels where the image's are not enlarged by
// fractions, so that one to one is exact.
function corner(pane, place, scale) {
  const x = pane.x + pane.width / 2 - place.x * scale;
  const y = pane.y + pane.height / 2 - place.y * scale;
  return [Math.round(x), Math.round(y)];
}

function drawPane(context, pane, picture, place, scale) {
  const [x, y] = corner(pane, place, scale);
  context.save();
  context.beginPath();
  context.rect(pane.from, pane.y, pane.to - pane.from, pane.height);
  context.clip();
  context.imageSmoothingEnabled = scale < SHARP_FROM && scale !== 1;
  context.imageSmoothingQuality = "high";
  context.drawImage(picture, x, y, picture.width * scale, picture.height * scale);
  context.restore();
}

// A frame around one image pixel, dark and light, seen on anything.
function drawMark(context, pane, place, scale, pixel) {
  const [x, y] = corner(pane, place, scale);
  const side = Math.max(scale, 7);
  const left = Math.round(x + (pixel.x + 0.5) * scale - side / 2);
  const top = Math.round(y + (pixel.y + 0.5) * scale - side / 2);
  context.save();
  context.beginPath();
  context.rect(pane.from, pane.y, pane.to - pane.from, pane.height);
  context.clip();
  context.strokeStyle = "#000";
  context.strokeRect(left - 1.5, top - 1.5, side + 3, side + 3);
  context.strokeStyle = "#fff";
  context.strokeRect(left - 0.5, top - 0.5, side + 1, side + 1);
  context.restore();
}

// The image pixel under a screen point, or null.
function pixelAt(pane, place, scale, x, y, width, height) {
  const [left, top] = corner(pane, place, scale);
  const column = Math.floor((x - left) / scale);
  const row = Math.floor((y - top) / scale);
  return column >= 0 && row >= 0 && column < width && row < height ? { x: column, y: row } : null;
}
