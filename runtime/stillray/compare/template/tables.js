// The two tables: figures against the reference, and values of one pixel.

function element(tag, text, attributes = {}) {
  const made = document.createElement(tag);
  if (text !== undefined) made.textContent = text;
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
}

function headRow(titles) {
  const row = element("tr");
  row.append(element("th", "Image", { scope: "col" }));
  for (const title of titles) row.append(element("th", title, { scope: "col" }));
  return row;
}

function nameCell(label) {
  const cell = element("th", undefined, { scope: "row" });
  cell.append(element("span", label, { class: "label", title: label }));
  return cell;
}

function fillMetrics(table, data, rows) {
  table.tHead.replaceChildren(headRow(data.metrics.map((metric) => metric.title)));
  table.tBodies[0].replaceChildren(
    ...rows.map((cells, image) => {
      const row = element("tr");
      row.append(nameCell(data.labels[image]));
      for (const { text, best } of cells) {
        const cell = element("td", text, best ? { class: "best" } : {});
        if (best) cell.append(element("span", " best", { class: "unseen" }));
        row.append(cell);
      }
      return row;
    }),
  );
}

// four significant digits, never wider than ten characters
function figure(value) {
  if (!Number.isFinite(value)) return Number.isNaN(value) ? "NaN" : value > 0 ? "+Inf" : "−Inf";
  const size = Math.abs(value);
  const text =
    value === 0 ? "0" : size < 1e-3 || size >= 1e5 ? value.toExponential(2) : value.toPrecision(4);
  return text.replace("-", "−");
}

// the rows of the pixel table are made once and filled often
function makePixelTable(table, labels, hasErrors, hasFlip) {
  const titles = ["R", "G", "B"];
  if (hasErrors) titles.push("error", "relative");
  if (hasFlip) titles.push("FLIP");
  table.tHead.replaceChildren(headRow(titles));
  const rows = labels.map((label) => {
    const row = element("tr");
    const name = nameCell(label);
    const swatch = element("span", undefined, { class: "swatch", "aria-hidden": "true" });
    name.prepend(swatch);
    const cells = titles.map(() => element("td", "–"));
    row.append(name, ...cells);
    table.tBodies[0].append(row);
    return { cells, swatch };
  });
  return (values) => {
    rows.forEach(({ cells, swatch }, image) => {
      const { figures = [], colour = "transparent" } = values?.[image] ?? {};
      swatch.style.background = colour;
      cells.forEach((cell, column) => {
        const value = figures[column];
        cell.textContent = value === undefined ? "–" : figure(value);
      });
    });
  };
}

// What a reader must know to trust the figures, in words. The same for all frames: a text that
// grows and shrinks would move the images.
function notes(data) {
  const [width, height] = data.full_size;
  let size = `${width} × ${height} pixels`;
  if (data.cropped) size += `, cropped at ${data.origin.join(", ")}`;
  if (data.downscale > 1) size += `, shown at 1/${data.downscale}; figures are of every pixel`;
  const told = [`${size}, half floats.`];
  data.labels.forEach((label, image) => {
    const sum = (counts) => data.frames.reduce((all, frame) => all + (frame[counts][image] ?? 0), 0);
    const bad = sum("not_finite");
    const clamped = sum("clamped");
    const are = (count) => `${count} ${count === 1 ? "pixel is" : "pixels are"}`;
    if (bad) told.push(`${label}: ${are(bad)} NaN or infinite, so there are no figures.`);
    if (clamped) told.push(`${label}: ${are(clamped)} above 65504, shown as that.`);
  });
  if (data.metrics.length) {
    const exposures = data.frames.filter((frame) => frame.has_reference).map((frame) => frame.exposure);
    const ends = [...new Set([Math.min(...exposures), Math.max(...exposures)].map((at) => signed(at, 2)))];
    told.push(
      `PSNR, SSIM and FLIP see the images at exposure ${ends.join(" to ")} stops (median of the ` +
        "reference to 0.2) and a power of 1/2.2, SMAPE and relative MSE exposed radiance.",
    );
    if (data.metrics.some((metric) => metric.name === "flicker")) {
      told.push("Flicker: mean error of the change from frame to frame.");
    }
    told.push("Error of a pixel: mean absolute difference of its channels, not exposed.");
    told.push("Signed: blue is darker than what it is held against, orange is brighter.");
  } else if (data.labels.length === data.images) {
    told.push("No reference, so no figures; differences are from the image that is chosen.");
  }
  if (data.transform) {
    told.push(`${data.transform.name}: OpenColorIO's, of light with the primaries of Rec. 709.`);
  }
  return told.join(" ");
}

function signed(value, digits) {
  const text = Math.abs(value).toFixed(digits);
  return Number(text) === 0 ? text : (value < 0 ? "−" : "+") + text;
}
