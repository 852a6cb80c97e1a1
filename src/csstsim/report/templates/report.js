// Pan and zoom of the focal plane, figures in full size, links that open the folds of their target. Nothing is fetched.
"use strict";

function viewer(figure) {
  const svg = figure.querySelector("svg.plane");
  const view = svg.querySelector(".view");
  const whole = svg.viewBox.baseVal;
  const home = [whole.x, whole.y, whole.width, whole.height];
  const most = whole.width / 40; // 40 pixels of a chip across the drawing
  let k = 1, tx = 0, ty = 0;

  function show() {
    view.setAttribute("transform", `translate(${tx} ${ty}) scale(${k})`);
    svg.style.touchAction = k > 1 ? "none" : "pan-y"; // a finger scrolls the page while nothing is zoomed
  }
  // Return the event's position in the drawing's units.
  function place(event) {
    return new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
  }
  function zoom(factor, x = whole.x + whole.width / 2, y = whole.y + whole.height / 2) {
    const next = Math.min(Math.max(k * factor, 1), most);
    tx = x - (x - tx) * (next / k);
    ty = y - (y - ty) * (next / k);
    k = next;
    keep();
  }
  // The middle of the view never leaves the focal plane.
  function keep() {
    const hold = (t, start, size) => {
      const middle = start + size / 2;
      return Math.min(Math.max(t, middle - k * (start + size)), middle - k * start);
    };
    tx = k === 1 ? 0 : hold(tx, whole.x, whole.width);
    ty = k === 1 ? 0 : hold(ty, whole.y, whole.height);
    show();
  }
  function fit([x, y, width, height], share) {
    k = Math.min(Math.max(share * Math.min(whole.width / width, whole.height / height), 1), most);
    tx = whole.x + whole.width / 2 - k * (x + width / 2);
    ty = whole.y + whole.height / 2 - k * (y + height / 2);
    keep();
  }
  const shown = () => [...svg.querySelectorAll(".exposure")].find((group) => group.style.display !== "none");
  const box = (name) => shown().dataset[name] && shown().dataset[name].split(" ").map(Number);
  const acts = {
    in: () => zoom(1.5),
    out: () => zoom(1 / 1.5),
    reset: () => fit(home, 1),
    exposure: () => fit(box("box"), 0.9),
    detail: () => box("detail") && fit(box("detail"), 0.9),
  };
  const move = (dx, dy) => () => { tx += dx * whole.width / 10; ty += dy * whole.width / 10; keep(); };
  const keys = {
    "+": acts.in, "=": acts.in, "-": acts.out, "0": acts.reset, "1": acts.exposure, "2": acts.detail,
    ArrowLeft: move(1, 0), ArrowRight: move(-1, 0), ArrowUp: move(0, 1), ArrowDown: move(0, -1),
  };

  function choose(number) {
    for (const group of figure.querySelectorAll("[data-number]")) {
      group.style.display = group.dataset.number === String(number) ? "" : "none";
    }
    figure.querySelector('[data-zoom="detail"]').disabled = !box("detail");
    acts.exposure();
  }

  for (const button of figure.querySelectorAll("[data-zoom]")) {
    button.addEventListener("click", acts[button.dataset.zoom]);
  }
  svg.addEventListener("wheel", (event) => {
    event.preventDefault();
    const at = place(event);
    zoom(Math.exp(-Math.sign(event.deltaY) * Math.min(Math.abs(event.deltaY) / 400, 0.4)), at.x, at.y);
  }, {passive: false});
  svg.addEventListener("keydown", (event) => {
    if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    keys[event.key]();
  });

  const fingers = new Map(); // pointers that are down, by id: one drags, two pinch
  svg.addEventListener("pointerdown", (event) => {
    svg.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, place(event));
  });
  svg.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const now = place(event);
    const other = [...fingers].filter(([id]) => id !== event.pointerId).map(([, point]) => point)[0];
    fingers.set(event.pointerId, now);
    if (other) {
      const gap = (point) => Math.hypot(point.x - other.x, point.y - other.y);
      zoom(gap(now) / Math.max(gap(before), 1e-9), other.x, other.y);
    } else {
      tx += now.x - before.x;
      ty += now.y - before.y;
      keep();
    }
  });
  for (const end of ["pointerup", "pointercancel"]) {
    svg.addEventListener(end, (event) => fingers.delete(event.pointerId));
  }

  const select = figure.querySelector("select");
  if (select) select.addEventListener("change", () => choose(select.value));
  choose(select ? select.value : 0); // a browser may remember what was chosen
}

function open() {
  const target = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (!target) return;
  for (const fold of target.querySelectorAll(":scope > details")) fold.open = true;
  for (let fold = target.closest("details"); fold; fold = fold.parentElement.closest("details")) fold.open = true;
  target.scrollIntoView();
}

for (const chart of document.querySelectorAll(".chart")) {
  chart.classList.add("zooms");
  chart.querySelector("img").addEventListener("click", () => chart.classList.toggle("large"));
}
document.querySelectorAll(".mosaic").forEach(viewer);
addEventListener("hashchange", open);
open();
