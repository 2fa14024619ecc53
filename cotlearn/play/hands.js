/** Panel 5, in notebooks only: push the T by hand. Python simulates and records. */

import { button, make, sentence } from "./controls.js";
import { Plane } from "./drawing.js";

const TENTH = 100; // milliseconds of a control step
const STRIDE = 14; // pixels that an arrow key moves the target
const PATIENCE = 3000; // milliseconds without an answer, after which the panel says so

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
  button(buttons, "Undo", () => ask({ do: "undo" }));

  let target = null;
  let pushing = false;
  let waiting = null; // since when, for Python's answer

  const view = () => model.get("view");

  function ask(message) {
    waiting ??= performance.now();
    model.send(message);
  }

  function step() {
    if (waiting === null && target !== null) ask({ do: "step", x: target[0], y: target[1] });
  }

  const timer = setInterval(() => {
    if (pushing) step();
    if (waiting !== null && performance.now() - waiting > PATIENCE) silent();
  }, TENTH);

  function silent() {
    pushing = false;
    said.textContent =
      "Python does not answer. Wait if a cell is running. If the kernel was started again, run this " +
      `cell again: it goes on after the ${counted(view().recorded)} of the file.`;
  }

  const counted = (count) => (count === 1 ? "1 episode" : `${count} episodes`);

  function answered() {
    waiting = null;
    const { coverage, step, recorded, note = "", problem = "" } = view();
    if (note || problem) pushing = false; // what the pointer still holds is not meant for a new start
    if (note) target = null;
    const now =
      step === 0
        ? "Push the grey T onto the green one: hold the pointer down."
        : `${Math.round(100 * coverage)} % covered after ${(step / 10).toFixed(1)} s; 95 % ends the episode.`;
    said.textContent = [problem, note, `${counted(recorded)} recorded.`, now].filter((part) => part).join(" ");
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
