/** Panel 5, in notebooks only: push the T by hand. Python simulates and records. */

import { button, make, sentence } from "./controls.js";
import { Plane } from "./drawing.js";

const TENTH = 100; // milliseconds of a control step
const STRIDE = 14; // pixels that an arrow key moves the target

export function mount(parent, { style, scene, model }) {
  const said = sentence(parent);
  const figure = make("figure", { style: "max-width: 32rem" });
  parent.append(figure);
  const plane = new Plane(figure, "Push-T: hold the pointer down, or use the arrow keys.");
  plane.canvas.tabIndex = 0;
  plane.canvas.className = "hand";
  plane.canvas.style.touchAction = "none";
  const buttons = make("div", { class: "buttons" });
  parent.append(buttons);
  button(buttons, "Undo", () => model.send({ do: "undo" }));

  let target = null;
  let pushing = false;
  let waiting = false; // for Python's answer to the last step

  const view = () => model.get("view");

  function step() {
    if (waiting || target === null) return;
    waiting = true;
    model.send({ do: "step", x: target[0], y: target[1] });
  }
  const timer = setInterval(() => pushing && step(), TENTH);

  function answered() {
    waiting = false;
    const { coverage, step, recorded } = view();
    const count = recorded === 1 ? "1 episode" : `${recorded} episodes`;
    said.textContent =
      step === 0
        ? `${count} recorded. Push the grey T onto the green one: hold the pointer down.`
        : `${count} recorded. ${Math.round(100 * coverage)} % covered after ${(step / 10).toFixed(1)} s; 95 % ends the episode.`;
    parent.dataset.recorded = recorded;
    parent.dataset.step = step;
    parent.dataset.state = view().state.join();
    paint();
  }

  function tee([x, y, angle]) {
    return scene.outline.map(([a, b]) => [
      x + Math.cos(angle) * a - Math.sin(angle) * b,
      y + Math.sin(angle) * a + Math.cos(angle) * b,
    ]);
  }

  function paint() {
    const { size, goal, radius } = scene;
    plane.frame([0, size, size, 0], [2, 2, 2, 2]);
    plane.clear();
    const { ink, line } = plane.theme;
    plane.area([[0, 0], [size, 0], [size, size], [0, size]], null, line);
    plane.area(tee(goal), style.goalArea);
    const now = view().state;
    plane.area(tee(now.slice(2)), style.block, ink);
    const color = plane.shade(style.looks.independent.color);
    plane.dot(now[0], now[1], (radius / size) * plane.width, color);
    if (target) plane.ring(...target, 5, ink, 1.5);
  }

  const inside = ([x, y]) => [x, y].map((v) => Math.max(0, Math.min(scene.size, v)));
  plane.canvas.addEventListener("pointerdown", (event) => {
    plane.canvas.setPointerCapture(event.pointerId);
    pushing = true;
    target = inside(plane.at(event));
    event.preventDefault();
    plane.canvas.focus();
  });
  plane.canvas.addEventListener("pointermove", (event) => {
    if (pushing) target = inside(plane.at(event));
  });
  for (const end of ["pointerup", "pointercancel"]) {
    plane.canvas.addEventListener(end, () => (pushing = false));
  }
  plane.canvas.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    if (!(event.key in steps)) return;
    event.preventDefault();
    event.stopPropagation(); // the notebook would move to another cell
    const from = target ?? view().state;
    target = inside([0, 1].map((k) => from[k] + STRIDE * steps[event.key][k]));
    step();
  });

  model.on("change:view", answered);
  answered();
  const watch = new ResizeObserver(paint);
  watch.observe(figure);
  return {
    stop() {
      clearInterval(timer);
      watch.disconnect();
      model.off("change:view", answered);
    },
  };
}
