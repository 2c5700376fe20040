// The read-out: difference, colours and spectra of the pixel that is pointed at.

const put = (id, text) => { document.getElementById(id).textContent = text; };
const decimal = (value, digits) => value.toFixed(digits).replace("-", "−");
const SVG = "http://www.w3.org/2000/svg";
let at = null;
let asked = 0;

/** Returns the sRGB colour of L*a*b*, its white being the screen's (CIE 15; IEC 61966-2-1). */
function screenColor([lightness, a, b]) {
  const fy = (lightness + 16) / 116;
  const cube = (f) => (f > 6 / 29 ? f ** 3 : 3 * (6 / 29) ** 2 * (f - 4 / 29));
  const x = 0.95047 * cube(fy + a / 500), y = cube(fy), z = 1.08883 * cube(fy - b / 200);
  const linear = [
    3.2404542 * x - 1.5371385 * y - 0.4985314 * z,
    -0.969266 * x + 1.8760108 * y + 0.041556 * z,
    0.0556434 * x - 0.2040259 * y + 1.0572252 * z,
  ];
  const encoded = linear.map((value) => {
    const inside = Math.min(1, Math.max(0, value));
    return Math.round(255 * (inside <= 0.0031308 ? 12.92 * inside
      : 1.055 * inside ** (1 / 2.4) - 0.055));
  });
  return `rgb(${encoded.join(" ")})`;
}

async function pixelAt(view, name, x, y) {
  const [left, top, width, height] = view.box;
  const row = view.pictures[name];
  if (!row || x < left || y < top || x >= left + width || y >= top + height) {
    return null;
  }
  const place = (y - top) * width + x - left;
  const step = (await planes(row.delta, width, false))[place];
  if (step === content.nothing) {
    return null;
  }
  const found = { delta: step * content.deltaStep };
  for (const key of ["truth", "lab"]) {
    if (row[key]) {
      const values = await planes(view.planes[row[key]], width, true);
      found[key] = [0, 1, 2].map((axis) =>
        values[axis * width * height + place] * content.labStep);
    }
  }
  return found;
}

/** Returns the nearest kept pixel that was judged, if there is one beside this one. */
function nearestKept(packed, truth, x, y) {
  const middleX = Math.round((x - packed.x) / packed.stride);
  const middleY = Math.round((y - packed.y) / packed.stride);
  let best = null;
  for (let row = middleY - 2; row <= middleY + 2; row += 1) {
    for (let column = middleX - 2; column <= middleX + 2; column += 1) {
      const isThere = row >= 0 && column >= 0 && row < packed.rows && column < packed.columns;
      if (isThere && truth[row * packed.columns + column] !== 0) {
        const far = Math.hypot(packed.x + column * packed.stride - x,
          packed.y + row * packed.stride - y);
        if (!best || far < best.far) {
          best = { row, column, far };
        }
      }
    }
  }
  return best;
}

async function spectraAt(view, name, x, y) {
  const packed = view.spectra;
  if (!packed || !packed.planes[name]) {
    return null;
  }
  const truth = await planes(packed.planes.truth, packed.columns, true);
  const nearest = nearestKept(packed, truth, x, y);
  if (!nearest) {
    return null;
  }
  const { row, column } = nearest;
  const spectra = [];
  for (const which of ["truth", name]) {
    const weights = await planes(packed.planes[which], packed.columns, true);
    spectra.push(packed.wavelengths.map((_, band) => packed.basis.reduce((sum, basis, index) =>
      sum + basis[band] * packed.step
        * weights[(index * packed.rows + row) * packed.columns + column], 0)));
  }
  return {
    spectra,
    x: packed.x + column * packed.stride,
    y: packed.y + row * packed.stride,
    wavelengths: packed.wavelengths,
    units: packed.units,
    error: packed.error,
  };
}

/** Returns text with its powers raised. */
const raised = (text) => text.replace(/\^?(-?\d+)/g, (_, digits) =>
  [...digits].map((digit) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(digit)]).join(""));

/** Returns a number of three digits. */
function short(value) {
  const [mantissa, exponent] = value.toExponential(2).split("e");
  return Math.abs(exponent) < 3 ? value.toPrecision(3)
    : `${mantissa} × 10${raised(String(Number(exponent)))}`;
}

function svgElement(parent, name, attributes, text) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) {
    made.setAttribute(key, value);
  }
  if (text !== undefined) {
    made.textContent = text;
  }
  parent.append(made);
}

function drawSpectra(found) {
  const drawing = document.getElementById("pixel-spectra");
  drawing.replaceChildren();
  if (!found || !found.spectra.flat().some((value) => value > 0)) {
    put("spectra-said", "");
    return;
  }
  const nm = found.wavelengths, last = nm.length - 1;
  const peak = Math.max(...found.spectra.flat());
  const toX = (value) => 2 + (296 * (value - nm[0])) / (nm[last] - nm[0] || 1);
  const toY = (value) => 122 - (104 * value) / peak;
  for (const [y, style] of [[122, "axis"], [18, "grid"]]) {
    svgElement(drawing, "line", { x1: 2, x2: 298, y1: y, y2: y, class: style });
  }
  const units = found.units.replaceAll(".", " ");
  svgElement(drawing, "text", { x: 2, y: 11 }, `${short(peak)} ${raised(units)}`);
  const middle = (nm[0] + nm[last]) / 2;
  svgElement(drawing, "text", { x: 2, y: 136 }, `${nm[0]}`);
  svgElement(drawing, "text", { x: toX(middle), y: 136, class: "middle" }, `${middle}`);
  svgElement(drawing, "text", { x: 298, y: 136, class: "end" }, `${nm[last]} nm`);
  ["truth", "estimate"].forEach((style, index) => {
    const points = found.spectra[index]
      .map((value, band) => `${toX(nm[band]).toFixed(1)},${toY(value).toFixed(1)}`).join(" ");
    svgElement(drawing, "polyline", { points, class: style });
  });
  put("spectra-said", `Spectra at ${found.x}, ${found.y}: truth dashed, reproduction solid; `
    + `within ${(100 * found.error).toFixed(1)} % of the picture's peak.`);
}

function showColors(found) {
  const fill = (id, lab) =>
    document.getElementById(id).setAttribute("fill", lab ? screenColor(lab) : "none");
  fill("swatch-truth", found && found.truth);
  fill("swatch-lab", found && found.lab);
  "Lab".split("").forEach((axis, index) => {
    const has = found && found.truth && found.lab;
    put(`truth-${axis}`, has ? decimal(found.truth[index], 1) : "–");
    put(`lab-${axis}`, has ? decimal(found.lab[index], 1) : "–");
    put(`change-${axis}`, has ? decimal(found.lab[index] - found.truth[index], 1) : "–");
  });
}

async function probe() {
  if (!at) {
    return;
  }
  const request = ++asked;
  const { view, name } = shown();
  const { x, y } = at;
  for (const cross of document.querySelectorAll(".cross")) {
    cross.classList.add("shown");
    cross.style.setProperty("--x", `${(100 * (x + 0.5)) / view.width}%`);
    cross.style.setProperty("--y", `${(100 * (y + 0.5)) / view.height}%`);
  }
  const found = view.box ? await pixelAt(view, name, x, y) : null;
  const spectra = found ? await spectraAt(view, name, x, y) : null;
  if (request !== asked) {
    return;
  }
  put("where", `Pixel ${x}, ${y}${found ? "" : ": not judged"}`);
  put("delta", found ? decimal(found.delta, 2) : "–");
  showColors(found);
  drawSpectra(spectra);
  document.getElementById("readout").dataset.pixel = `${x},${y}`;
}

function pointAt(event, parent) {
  const { view } = shown();
  const box = parent.getBoundingClientRect();
  const inside = (share, count) => Math.min(count - 1, Math.max(0, Math.floor(share * count)));
  at = {
    x: inside((event.clientX - box.left) / box.width, view.width),
    y: inside((event.clientY - box.top) / box.height, view.height),
  };
  probe();
}

function step(event) {
  const { view } = shown();
  const far = event.shiftKey ? 10 : 1;
  const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  const move = moves[event.key];
  if (!move || event.altKey || event.ctrlKey || event.metaKey) {
    return;
  }
  event.preventDefault();
  const from = at || { x: Math.floor(view.width / 2), y: Math.floor(view.height / 2) };
  at = {
    x: Math.min(view.width - 1, Math.max(0, from.x + far * move[0])),
    y: Math.min(view.height - 1, Math.max(0, from.y + far * move[1])),
  };
  probe().then(() => put("said", `${document.getElementById("where").textContent}, difference `
    + document.getElementById("delta").textContent));
}

/** Points at the pixel that differs most. */
function pointAtWorst() {
  const { view, name } = shown();
  const worst = view.pictures[name] && view.pictures[name].worst;
  if (worst) {
    at = { x: worst[0], y: worst[1] };
    probe();
  }
}

if (content && stage) {
  for (const parent of [stage, heat]) {
    if (parent) {
      parent.addEventListener("pointermove", (event) => pointAt(event, parent));
      parent.addEventListener("pointerdown", (event) => pointAt(event, parent));
      parent.addEventListener("keydown", step);
    }
  }
  moved.push(probe);
  document.getElementById("worst").addEventListener("click", pointAtWorst);
  if (typeof DecompressionStream !== "undefined") {
    pointAtWorst();
  }
  if (typeof DecompressionStream === "undefined") {
    put("where", "This browser is too old to unpack the pixels");
  }
}
