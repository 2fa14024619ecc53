/** Panel 1: pair noise with data, and see what that does to the noise of each condition. */

import { pair, take } from "./assignment.js";
import { ARROWS, button, choice, drag, figure, Later, playButton, sentence, slider } from "./controls.js";
import { animate, conditionColor, Plane, still } from "./drawing.js";
import { explained, oneStepVariance, skew } from "./measures.js";
import { draw, meansAt, shownConditions } from "./mixtures.js";
import { Random } from "./random.js";

const POOL = 1024; // rows behind the numbers
const PLACES = 42; // of the slider of w: 0, forty from 0.1 to 1000, infinity
const ROWS = [16, 32, 64, 128, 256];
const SWEEP = [0, 0.3, 1, 3, 10, 30, 100, 300, Infinity];
const SECONDS = 4; // from noise to data and back

/** The weight at a place of the slider. */
export function weightAt(place) {
  if (place === 0) return 0;
  if (place === PLACES - 1) return Infinity;
  return Number((10 ** (-1 + (4 * (place - 1)) / (PLACES - 3))).toPrecision(2));
}

/** A weight in words. */
export const weightWords = (w) => `w = ${w === Infinity ? "∞" : w}`;

/** Half the side of a square that shows a mixture and the noise. */
export function limitOf(mixture) {
  return Math.max(3.4, ...mixture.means.flat(2).map((x) => Math.abs(x) + 0.9));
}

const percent = (share) => `${Math.round(100 * Math.max(0, share))} %`;

/** Draw `rows` of noise and data; the same seed draws the same. */
export function drawBatch(mixture, rows, seed) {
  const random = new Random(seed);
  const data = draw(mixture, rows, random);
  return { ...data, x0: random.normals(2 * rows), order: random.permutation(rows) };
}

/** The three numbers of a coupling, from its pairs in several batches. */
export function measure(batches, pairings) {
  const join = (parts) => Float64Array.from(parts.flatMap((part) => Array.from(part)));
  const { k } = batches[0];
  const x0 = join(batches.map((batch) => batch.x0));
  const x1 = join(batches.map((batch, i) => take(batch.x1, pairings[i], 2)));
  const c = join(batches.map((batch, i) => take(batch.c, pairings[i], k)));
  const random = new Random(7);
  const rows = random.permutation(x0.length / 2);
  const shuffle = random.permutation(Math.ceil(rows.length / 2));
  return {
    explained: explained(x0, c, k),
    skew: skew(x0, c, k, rows, shuffle),
    variance: oneStepVariance(x0, x1, c, k),
  };
}

/** What the numbers say. */
export function describe(coupling, w, { explained, skew, variance }) {
  const numbers = `The condition explains ${percent(explained)} of the noise`;
  const step = `one step from a given noise leaves a variance of ${variance.toFixed(1)}`;
  if (coupling === "independent") {
    return (
      "Independent pairs: the noise knows nothing of the condition. " +
      `${numbers}. But it also says nothing about where to go: paths cross, and ${step}.`
    );
  }
  const name = coupling === "naive" ? "Naive OT" : `Conditional OT, ${weightWords(w)}`;
  if (skew > 0.1) {
    const how =
      explained > 0.1
        ? `The condition explains ${percent(explained)} of the noise`
        : "No condition moves the middle of the noise, yet each cuts out its own part";
    return (
      `${name} gives each condition its own slice of the noise. ${how}. ` +
      "Who samples draws from the whole noise, and meets slices that the model never saw."
    );
  }
  const rest = skew > 0.03 ? "The slices are almost gone" : "Every condition meets the whole noise";
  return `${name}: ${rest[0].toLowerCase()}${rest.slice(1)}. ${numbers}, and ${step}.`;
}

export function mount(parent, { style, mixtures, link, sample = null }) {
  const defaults = { data: "petals", coupling: "naive", w: 24, rows: 128, seed: 1 };
  const state = { ...link.read(defaults) };
  for (const name of ["w", "rows", "seed"]) state[name] = Number(state[name]) || 0;
  if (!(state.data in mixtures)) state.data = defaults.data;
  if (!ROWS.includes(state.rows)) state.rows = defaults.rows;
  if (!["independent", "naive", "conditional"].includes(state.coupling)) state.coupling = "naive";

  const handle = { state, batches: [], pairings: [], numbers: null, sweep: [], time: 0 };
  const numbersLater = new Later();
  const sweepLater = new Later();

  // --- controls

  const said = sentence(parent);
  const controls = document.createElement("div");
  controls.className = "controls";
  parent.append(controls);
  const names = Object.entries(mixtures).map(([name, { title }]) => [name, title]);
  choice(controls, "Data", names, state.data, (data) => change({ data }, redraw));
  const couplings = [
    ["independent", style.looks.independent.label],
    ["naive", style.looks.minibatch_ot.label],
    ["conditional", "conditional OT"],
  ];
  const chosen = choice(controls, "Pairs", couplings, state.coupling, (coupling) => {
    change({ coupling }, repair);
  });
  const words = (place) => weightWords(weightAt(place));
  const weight = slider(controls, "Weight of the condition", PLACES, state.w, words, (w) => {
    change({ w, coupling: w === 0 ? "naive" : "conditional" }, repair);
  });
  slider(controls, "Rows in a batch", ROWS.length, ROWS.indexOf(state.rows), (i) => ROWS[i], (i) => {
    change({ rows: ROWS[i] }, redraw);
  });
  const buttons = document.createElement("div");
  buttons.className = "buttons";
  controls.append(buttons);
  if (sample) button(buttons, "Sample", () => sample(state), "primary");
  button(buttons, "New batch", () => change({ seed: state.seed + 1 }, redraw));
  const play = playButton(buttons, !still(), () => {});

  // --- figures

  const figures = document.createElement("div");
  figures.className = "figures three";
  parent.append(figures);
  const plane = new Plane(figure(figures, "Pairs: noise meets data"), "Pairs of noise and data");
  const cake = new Plane(figure(figures, "The noise that each condition met"), "The paired noise");
  const chart = new Plane(figure(figures, "Both should be small"), "Skew against variance");
  plane.canvas.tabIndex = 0;
  plane.canvas.setAttribute(
    "aria-label",
    "Pairs of noise and data. Arrow keys move the ringed data point, N takes the next one.",
  );
  plane.canvas.className = "hand";

  // --- what follows from the choices

  const mixture = () => mixtures[state.data];
  const currentWeight = () =>
    state.coupling === "independent" ? null : state.coupling === "naive" ? 0 : weightAt(state.w);

  function change(choices, then) {
    Object.assign(state, choices);
    if (state.coupling === "conditional" && weightAt(state.w) === 0) state.w = defaults.w;
    chosen.value = state.coupling;
    if (state.coupling !== "independent") {
      weight.value = state.coupling === "naive" ? 0 : state.w;
    }
    link.write(state, defaults);
    then();
  }

  function redraw() {
    const count = Math.max(4, POOL / state.rows);
    handle.batches = Array.from({ length: count }, (_, i) =>
      drawBatch(mixture(), state.rows, 1000 * state.seed + i),
    );
    handle.sweep = [];
    handle.held = 0;
    sweepLater.run(sweep());
    repair();
  }

  /** Pair the shown batch at once, the others when there is time. */
  function repair() {
    handle.pairings = [pair(handle.batches[0], currentWeight())];
    numbersLater.run(count());
    paint();
  }

  function* pairAll(weight, first = []) {
    const pairings = [...first];
    for (let i = pairings.length; i < handle.batches.length; i++) {
      pairings.push(pair(handle.batches[i], weight));
      if (i % Math.ceil(128 / state.rows) === 0) yield pairings;
    }
    return pairings;
  }

  function* count() {
    const first = handle.pairings;
    for (const part of pairAll(currentWeight(), first)) {
      handle.pairings = part;
      yield;
    }
    handle.numbers = measure(handle.batches, handle.pairings);
    said.textContent = describe(state.coupling, currentWeight(), handle.numbers);
    Object.assign(parent.dataset, handle.numbers);
    paint();
  }

  function* sweep() {
    for (const w of [null, ...SWEEP]) {
      const pairings = yield* pairAll(w);
      handle.sweep.push({ w, ...measure(handle.batches, pairings) });
      yield;
      paint();
    }
  }

  // --- drawing

  const color = (value) => plane.shade(conditionColor(style, mixture().labelled, value));

  function paint() {
    paintPairs();
    paintCake();
    paintChart();
  }

  function paintPairs() {
    const limit = limitOf(mixture());
    plane.frame([-limit, limit, -limit, limit]);
    plane.clear();
    const { x0, x1, value } = handle.batches[0];
    const share = (1 - Math.cos(2 * Math.PI * (handle.time / SECONDS))) / 2;
    handle.pairings[0].forEach((j, i) => {
      const [a, b] = [2 * i, 2 * j];
      const tint = color(value[j]);
      plane.line([[x0[a], x0[a + 1]], [x1[b], x1[b + 1]]], tint, 1, 0.4);
      plane.dot(x0[a], x0[a + 1], 1.6, plane.theme.ink, 0.6);
      plane.dot(x1[b], x1[b + 1], 2.6, tint, 0.9);
      const [x, y] = [0, 1].map((d) => (1 - share) * x0[a + d] + share * x1[b + d]);
      plane.dot(x, y, 3.2, tint);
    });
    const held = 2 * handle.held;
    plane.ring(x1[held], x1[held + 1], 7, plane.theme.ink);
    nameConditions();
  }

  /** A number beside the data of each label; for numbers, words at both ends. */
  function nameConditions() {
    const shown = mixture().labelled ? shownConditions(mixture()) : [-1, 0, 1];
    for (const value of shown) {
      const modes = meansAt(mixture(), value);
      const [x, y] = mixture().labelled
        ? [0, 1].map((k) => modes.reduce((sum, mode) => sum + mode[k], 0) / modes.length)
        : modes[modes.length - 1].map((place) => Math.min(1.22 * place, 0.87 * limitOf(mixture())));
      const words = `c = ${value}`.replace("-", "−");
      plane.text(words, x, y, { color: plane.theme.ink, bold: true });
    }
  }

  function paintCake() {
    cake.frame([-3.3, 3.3, -3.3, 3.3]);
    cake.clear();
    handle.pairings.forEach((pairing, at) => {
      const { x0, value } = handle.batches[at];
      pairing.forEach((j, i) => cake.dot(x0[2 * i], x0[2 * i + 1], 2.4, color(value[j]), 0.85));
    });
  }

  function paintChart() {
    const points = handle.sweep;
    const all = handle.numbers ? [...points, handle.numbers] : points;
    const top = Math.max(0.5, ...all.map((p) => p.variance)) * 1.1;
    const right = Math.max(0.2, ...all.map((p) => p.skew)) * 1.12;
    chart.frame([-0.03, right, 0, top], [30, 12, 40, 30]);
    chart.clear();
    const step = top > 4 ? 2 : top > 1.6 ? 1 : 0.5;
    const ticks = (end, by) => Array.from({ length: Math.floor(end / by) + 1 }, (_, i) => i * by);
    chart.axes({
      xTicks: ticks(right, 0.2).map((x) => [x, x.toFixed(1)]),
      yTicks: ticks(top, step),
      xLabel: "skew of the noise →",
      yLabel: "one-step variance",
    });
    const curve = points.filter((p) => p.w !== null);
    const place = (p) => [p.skew, p.variance];
    const { conditional_ot, independent, minibatch_ot } = style.looks;
    chart.line(curve.map(place), chart.shade(conditional_ot.color), 2);
    for (const point of curve) chart.dot(...place(point), 3, chart.shade(conditional_ot.color));
    const named = [[null, independent, "left"], [0, minibatch_ot, "right"]];
    for (const [w, look, align] of named) {
      const point = points.find((p) => p.w === w);
      if (!point) continue;
      chart.dot(...place(point), 5, chart.shade(look.color));
      const dy = w === null ? -13 : 15;
      chart.text(look.label, ...place(point), { color: chart.shade(look.color), align, dy });
    }
    if (handle.numbers) {
      chart.ring(...place(handle.numbers), 8, chart.theme.ink, 2.5);
      chart.canvas.setAttribute(
        "aria-label",
        `Skew ${handle.numbers.skew.toFixed(2)}, variance ${handle.numbers.variance.toFixed(1)}`,
      );
    }
  }

  // --- hands

  function move(point, [x, y]) {
    const { x1 } = handle.batches[0];
    const limit = limitOf(mixture());
    x1[2 * point] = Math.max(-limit, Math.min(limit, x));
    x1[2 * point + 1] = Math.max(-limit, Math.min(limit, y));
    repair();
  }

  function takes([x, y]) {
    const { x1 } = handle.batches[0];
    const away = (i) => Math.hypot(x1[2 * i] - x, x1[2 * i + 1] - y);
    const all = Array.from({ length: state.rows }, (_, i) => i);
    const near = all.reduce((best, i) => (away(i) < away(best) ? i : best));
    if (away(near) > 0.08 * limitOf(mixture())) return false;
    handle.held = near;
    return true;
  }

  drag(plane, takes, (place) => move(handle.held, place));
  plane.canvas.addEventListener("keydown", (event) => {
    const { x1 } = handle.batches[0];
    if (event.key in ARROWS) {
      const [x, y] = ARROWS[event.key].map((step, k) => x1[2 * handle.held + k] + 0.2 * step);
      move(handle.held, [x, y]);
    } else if (event.key.toLowerCase() === "n") {
      handle.held = (handle.held + 1) % state.rows;
      paintPairs();
    } else return;
    event.preventDefault();
  });

  handle.move = move;
  change({}, redraw);
  const stop = animate(plane.canvas, (seconds) => {
    if (play.playing) handle.time += seconds;
    if (play.playing) paintPairs();
  });
  const watch = new ResizeObserver(paint);
  watch.observe(figures);
  handle.stop = () => {
    stop();
    watch.disconnect();
  };
  return handle;
}
