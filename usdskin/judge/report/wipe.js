// The wipe: a slider, or a finger, moves the line between truth and reproduction.

const stage = document.getElementById("wipe");
const heat = document.getElementById("heat");
const slider = document.getElementById("wipe-at");
const moved = [];

function chosen(group) {
  return document.querySelector(`input[name="${group}"]:checked`).value;
}

function shown() {
  const view = content.views[chosen("integrator")];
  return { integrator: chosen("integrator"), name: chosen("reproduction"), view };
}

/** Returns an embedded picture; every picture is in the page once. */
function picture(kind, name, integrator) {
  for (const image of document.querySelectorAll(`img[data-${kind}]`)) {
    if (image.dataset[kind] === name && image.dataset.integrator === integrator) {
      return image;
    }
  }
  return null;
}

function place(parent, className, source) {
  let image = parent.querySelector(`img.${className}`);
  if (!image) {
    image = document.createElement("img");
    image.className = className;
    image.draggable = false;
    parent.insertBefore(image, parent.querySelector(".divider, .cross"));
  }
  image.hidden = !source;
  if (source) {
    image.src = source.src;
    image.alt = source.alt;
    image.width = source.getAttribute("width");
    image.height = source.getAttribute("height");
  }
  return image;
}

function wipeTo(share) {
  stage.style.setProperty("--at", `${100 * share}%`);
}

function refresh() {
  const { integrator, name } = shown();
  const truth = place(stage, "below", picture("render", "truth", integrator));
  for (const parent of [stage, heat]) {
    if (parent) {
      parent.style.setProperty("--ratio", truth.width / truth.height);
    }
  }
  place(stage, "above", picture("render", name, integrator));
  if (heat) {
    place(heat, "below", picture("heat", name, integrator)).classList.add("heat");
  }
  for (const legend of document.querySelectorAll("[data-legend]")) {
    legend.classList.toggle("away", legend.dataset.legend !== integrator);
  }
  for (const tell of moved) {
    tell();
  }
}

function allowOnlyWhatIsThere() {
  const { view } = shown();
  const options = [...document.querySelectorAll('input[name="reproduction"]')];
  for (const option of options) {
    option.disabled = !(option.value in view.titles);
  }
  if (!(chosen("reproduction") in view.titles)) {
    options.find((option) => !option.disabled).checked = true;
  }
}

function startWipe() {
  let dragging = false;
  const follow = (event) => {
    const box = stage.getBoundingClientRect();
    const share = Math.min(1, Math.max(0, (event.clientX - box.left) / box.width));
    slider.value = Math.round(1000 * share);
    wipeTo(share);
  };
  slider.addEventListener("input", () => wipeTo(slider.value / 1000));
  stage.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) {
      return;
    }
    dragging = true;
    stage.setPointerCapture(event.pointerId);
    follow(event);
  });
  stage.addEventListener("pointermove", (event) => dragging && follow(event));
  for (const name of ["pointerup", "pointercancel"]) {
    stage.addEventListener(name, () => { dragging = false; });
  }
  for (const option of document.querySelectorAll(".choices input")) {
    option.addEventListener("change", () => {
      allowOnlyWhatIsThere();
      refresh();
    });
  }
  slider.value = 500;
  wipeTo(0.5);
  refresh();
}

if (content && stage) {
  startWipe();
}
