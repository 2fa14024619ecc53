/** Panel 2: trained networks carry noise to samples, in as many evaluations as the reader likes. */

import { ARROWS, button, choice, drag, figure, Later, playButton, sentence, slider } from "./controls.js";
import { numbers } from "./data.js";
import { animate, conditionColor, Plane, still } from "./drawing.js";
import { squaredW2 } from "./measures.js";
import { conditions, draw, drawGiven, shownConditions } from "./mixtures.js";
import { Network } from "./network.js";
import { limitOf, weightAt, weightWords } from "./pairs.js";
import { Random } from "./random.js";

const STEPS = [1, 2, 4, 8, 16, 32]; // evaluations
const SHOWN = 128; // rows of noise
const SCORED = 96; // rows of noise behind an error, for each condition
const TESTED = 5; // conditions at most
const SECONDS = 2.5; // from noise to sample
const REST = 1.5; // seconds at the end
const WRONG = 2; // times what independent pairs reach: steps do not help
const BENT = 1.5; // times the error of 32 steps: steps help

/** The name of the stored network nearest to a weight; w = infinity may be the independent one. */
export function stored(networks, coupling, w) {
  if (coupling === "independent") return "independent";
  if (w === Infinity) return "inf" in networks ? "inf" : "independent";
  const far = (name) => Math.abs(Math.log(Number(name) + 0.1) - Math.log(w + 0.1));
  const finite = Object.keys(networks).filter((name) => Number.isFinite(Number(name)));
  return finite.reduce((best, name) => (far(name) < far(best) ? name : best));
}

/**
 * Noise and truth of some conditions, and the distance of two samples of the truth: the floor.
 *
 * So that few rows are enough, every mode of the truth has its share of them, and every row of noise
 * has its mirror image.
 */
export function makeTest(mixture, seed = 5) {
  const random = new Random(seed);
  const all = shownConditions(mixture);
  const tested = all.length > TESTED ? all.filter((_, i) => i % 2 === 0) : all;
  const groups = tested.map((value) => {
    const same = new Float64Array(SCORED).fill(value);
    const [truth, other] = [0, 1].map(() => drawGiven(mixture, same, random, true));
    const half = random.normals(SCORED);
    const x0 = Float64Array.from([...half, ...half.map((x) => -x)]);
    return { x0, truth, floor: squaredW2(truth, other), ...conditions(mixture, same) };
  });
  return { groups, floor: mean(groups.map((group) => group.floor)) };
}

const mean = (values) => values.reduce((a, b) => a + b, 0) / values.length;

/** Squared W2 between samples and truth of one condition. */
export function errorIn(network, { x0, c, truth }, steps) {
  return squaredW2(network.paths(x0, c, steps)[steps], truth);
}

/**
 * What the errors say.
 *
 * @param {number[]} errors - one for each of STEPS.
 * @param {number} reference - of independent pairs with all steps: their law is right, so it is what
 *   this small network can reach.
 */
export function describe(name, steps, errors, reference) {
  const [first, now, last] = [errors[0], errors[STEPS.indexOf(steps)], errors.at(-1)];
  const form = (error) => error.toFixed(2);
  const times = steps === 1 ? "one evaluation" : `${steps} evaluations`;
  const error = `${name}, ${times}: the samples miss the truth by ${form(now)}.`;
  if (last > WRONG * reference) {
    const right = `independent pairs get to ${form(reference)}`;
    return `${error} With 32 evaluations it is ${form(last)}, where ${right}: no number of steps repairs it.`;
  }
  if (first > BENT * last) {
    return `${error} One evaluation gives ${form(first)}, 32 give ${form(last)}: the paths are bent, and need steps.`;
  }
  return `${error} One evaluation gives ${form(first)}, 32 give ${form(last)}: the paths are straight, one step is enough.`;
}

export function mount(parent, { style, mixtures, networks, link }) {
  const defaults = { data: "petals", pairs: "0", steps: 1, seed: 1 };
  const state = { ...link.read(defaults) };
  for (const name of ["steps", "seed"]) state[name] = Number(state[name]) || 1;
  if (!(state.data in mixtures)) state.data = defaults.data;
  if (!(state.pairs in networks.weights[state.data])) state.pairs = defaults.pairs;
  if (!STEPS.includes(state.steps)) state.steps = defaults.steps;

  const handle = { state, paths: [], errors: new Map(), time: 0, held: 0, point: null };
  const tests = new Map();
  const loaded = new Map();
  const later = new Later();

  const mixture = () => mixtures[state.data];
  const names = () => Object.keys(networks.weights[state.data]);
  const network = (pairs = state.pairs) => {
    const key = `${state.data} ${pairs}`;
    if (!loaded.has(key)) {
      const weights = numbers(networks.weights[state.data][pairs]);
      loaded.set(key, new Network(weights, networks.sizes[state.data]));
    }
    return loaded.get(key);
  };
  handle.network = network;
  handle.move = move;
  const test = () => {
    if (!tests.has(state.data)) tests.set(state.data, makeTest(mixture()));
    return tests.get(state.data);
  };
  const nameOf = (pairs) => {
    if (pairs === "independent") return "Independent pairs";
    return pairs === "0" ? "Naive OT" : `Conditional OT, ${weightWords(Number(finite(pairs)))}`;
  };
  const finite = (pairs) => (pairs === "inf" ? Infinity : pairs);

  // --- controls

  const said = sentence(parent);
  const controls = document.createElement("div");
  controls.className = "controls";
  parent.append(controls);
  const titles = Object.entries(mixtures).map(([name, { title }]) => [name, title]);
  const data = choice(controls, "Data", titles, state.data, (name) => change({ data: name }));
  const couplings = [
    ["independent", style.looks.independent.label],
    ["naive", style.looks.minibatch_ot.label],
    ["conditional", "conditional OT"],
  ];
  const kindOf = (pairs) =>
    pairs === "independent" ? pairs : pairs === "0" ? "naive" : "conditional";
  const chosen = choice(controls, "Trained with", couplings, kindOf(state.pairs), (kind) => {
    change({ pairs: kind === "naive" ? "0" : kind === "independent" ? kind : "10" });
  });
  const weights = ["0", "1", "3", "10", "30", "100", "inf"];
  const words = (place) => weightWords(Number(finite(weights[place])));
  const place = () => Math.max(0, weights.indexOf(state.pairs));
  const weight = slider(controls, "Weight of the condition", weights.length, place(), words, (at) => {
    change({ pairs: weights[at] in networks.weights[state.data] ? weights[at] : "independent" });
  });
  const evaluations = slider(
    controls, "Evaluations", STEPS.length, STEPS.indexOf(state.steps), (at) => STEPS[at],
    (at) => change({ steps: STEPS[at] }),
  ); // prettier-ignore
  const ringed = slider(controls, "Condition of the ringed noise", 9, 0, (at) => nameAt(at), (at) => {
    handle.held = at;
    change({});
  });
  const buttons = document.createElement("div");
  buttons.className = "buttons";
  controls.append(buttons);
  button(buttons, "Sample", () => change({ seed: state.seed + 1 }), "primary");
  const play = playButton(buttons, !still(), () => {});

  const figures = document.createElement("div");
  figures.className = "figures two";
  parent.append(figures);
  const plane = new Plane(figure(figures, "From noise to samples"), "");
  const chart = new Plane(figure(figures, "Error against evaluations"), "", 0.75);
  plane.canvas.tabIndex = 0;
  plane.canvas.className = "hand";
  plane.canvas.setAttribute(
    "aria-label",
    "Paths from noise to samples. Arrow keys or a pointer move the ringed noise.",
  );

  // --- what follows from the choices

  function nameAt(at) {
    const value = shownConditions(mixture())[at];
    return `c = ${mixture().labelled ? value : value.toFixed(1)}`.replace("-", "−");
  }

  function change(choices) {
    const before = state.data;
    Object.assign(state, choices);
    if (!(state.pairs in networks.weights[state.data])) state.pairs = "independent";
    chosen.value = kindOf(state.pairs);
    data.value = state.data;
    if (state.pairs !== "independent") weight.value = place();
    const count = shownConditions(mixture()).length;
    ringed.input.max = count - 1;
    if (handle.held >= count) handle.held = 0;
    ringed.value = handle.held;
    evaluations.value = STEPS.indexOf(state.steps);
    if (before !== state.data) handle.point = null;
    link.write(state, defaults);
    handle.time = 0;
    follow();
    later.run(score());
  }

  /** Carry the shown noise, and the ringed one, to t = 1. */
  function follow() {
    const random = new Random(state.seed);
    const shown = shownConditions(mixture());
    handle.value = Float64Array.from({ length: SHOWN }, (_, i) => shown[i % shown.length]);
    const { c } = conditions(mixture(), handle.value);
    handle.paths = network().paths(random.normals(2 * SHOWN), c, state.steps);
    handle.truth = draw(mixture(), 600, new Random(3));
    trace();
    paint();
  }

  /** The path of the ringed noise. */
  function trace() {
    handle.point ??= [0.9, 0.6];
    const value = Float64Array.of(shownConditions(mixture())[handle.held]);
    const { c } = conditions(mixture(), value);
    handle.trace = network().paths(Float64Array.from(handle.point), c, state.steps);
  }

  /** Errors of these pairs, and of the two that everybody knows, at all numbers of evaluations. */
  function* score() {
    for (const pairs of new Set(["independent", state.pairs, "0"])) {
      const key = `${state.data} ${pairs}`;
      if (!handle.errors.has(key)) {
        const errors = [];
        for (const steps of STEPS) {
          const parts = [];
          for (const group of test().groups) {
            parts.push(errorIn(network(pairs), group, steps));
            yield;
          }
          errors.push(mean(parts));
        }
        handle.errors.set(key, errors);
      }
      if (pairs === state.pairs) say(handle.errors.get(key));
      paintChart();
    }
  }

  function say(errors) {
    const reference = handle.errors.get(`${state.data} independent`).at(-1);
    said.textContent = describe(nameOf(state.pairs), state.steps, errors, reference);
    parent.dataset.error = errors[STEPS.indexOf(state.steps)];
    parent.dataset.floor = test().floor;
  }

  // --- drawing

  const color = (value) => plane.shade(conditionColor(style, mixture().labelled, value));

  function paint() {
    paintPlane();
    paintChart();
  }

  /** Where row i of the paths is at a share of the way. */
  function along(paths, i, share) {
    const place = share * (paths.length - 1);
    const step = Math.min(Math.floor(place), paths.length - 2);
    const [a, b] = [paths[step], paths[step + 1]];
    return [0, 1].map((k) => a[2 * i + k] + (place - step) * (b[2 * i + k] - a[2 * i + k]));
  }

  function paintPlane() {
    const limit = limitOf(mixture());
    const share = still() && !play.playing ? 1 : Math.min(1, handle.time / SECONDS);
    const { paths, truth, value } = handle;
    plane.frame([-limit, limit, -limit, limit]);
    plane.clear();
    truth.value.forEach((own, i) => {
      plane.dot(truth.x1[2 * i], truth.x1[2 * i + 1], 4.5, color(own), 0.13);
    });
    for (let i = 0; i < SHOWN; i++) {
      const points = paths.map((state) => [state[2 * i], state[2 * i + 1]]);
      plane.line(points, plane.theme.soft, 0.7, 0.35);
      plane.dot(...points[0], 1.4, plane.theme.ink, 0.5);
    }
    value.forEach((own, i) => plane.dot(...along(paths, i, share), 3, color(own)));
    const points = handle.trace.map((state) => [state[0], state[1]]);
    const tint = color(shownConditions(mixture())[handle.held]);
    plane.line(points, tint, 3);
    for (const [x, y] of points) plane.dot(x, y, 3.5, tint);
    plane.ring(...points[0], 9, plane.theme.ink, 2.5);
    plane.dot(...along(handle.trace, 0, share), 6, tint);
  }

  function paintChart() {
    const of = (pairs) => handle.errors.get(`${state.data} ${pairs}`);
    const { floor } = test();
    const curves = ["independent", "0", state.pairs].map(of).filter((errors) => errors);
    const log = Math.log10;
    const top = log(Math.max(10 * floor, ...curves.flat()) * 1.3);
    const bottom = log(floor / 2);
    chart.frame([-0.3, STEPS.length - 0.7, bottom, top], [30, 12, 40, 40]);
    chart.clear();
    const marks = [0.01, 0.03, 0.1, 0.3, 1, 3, 10, 30, 100];
    chart.axes({
      xTicks: STEPS.map((steps, i) => [i, String(steps)]),
      yTicks: marks.map(log).filter((y) => y > bottom && y < top),
      form: (y) => String(Number((10 ** y).toPrecision(1))),
      xLabel: "evaluations of the network",
      yLabel: "squared distance to the truth (W2)",
    });
    const ends = [-0.3, STEPS.length - 0.7];
    chart.line(ends.map((x) => [x, log(floor)]), chart.theme.ink, 1.3, 1, [2, 3]);
    chart.text("truth against truth", -0.2, log(floor), { align: "left", dy: 11 });
    const { conditional_ot, independent, minibatch_ot } = style.looks;
    const looks = { independent, 0: minibatch_ot };
    const named = []; // heights at which a curve's name stands
    for (const pairs of new Set(["independent", "0", state.pairs])) {
      const errors = of(pairs);
      if (!errors) continue;
      const look = looks[pairs] ?? conditional_ot;
      const tint = chart.shade(look.color);
      const mine = pairs === state.pairs;
      chart.line(errors.map((error, i) => [i, log(error)]), tint, mine ? 3 : 1.5);
      errors.forEach((error, i) => chart.dot(i, log(error), mine ? 4 : 2.5, tint));
      const label = pairs in looks ? look.label : weightWords(Number(finite(pairs)));
      const end = chart.y(log(errors.at(-1)));
      const dy = named.some((y) => Math.abs(y - end + 11) < 14) ? 14 : -11;
      named.push(end + dy);
      chart.text(label, STEPS.length - 1, log(errors.at(-1)), { color: tint, align: "right", dy, bold: mine });
    }
    const now = of(state.pairs);
    if (now) {
      const at = STEPS.indexOf(state.steps);
      chart.ring(at, log(now[at]), 8, chart.theme.ink, 2.5);
      chart.canvas.setAttribute("aria-label", said.textContent);
    }
  }

  // --- hands

  function move([x, y]) {
    handle.point = [x, y].map((value) => Math.max(-3.3, Math.min(3.3, value)));
    trace();
    paintPlane();
  }

  const reach = () => 0.12 * limitOf(mixture());
  const takes = ([x, y]) => Math.hypot(x - handle.point[0], y - handle.point[1]) <= reach();
  drag(plane, takes, move);
  plane.canvas.addEventListener("keydown", (event) => {
    if (!(event.key in ARROWS)) return;
    event.preventDefault();
    move(handle.point.map((value, k) => value + 0.15 * ARROWS[event.key][k]));
  });

  /** Take over the pairs of panel 1. */
  handle.follow = (name, coupling, slot) => {
    const w = coupling === "naive" ? 0 : weightAt(slot);
    change({ data: name, pairs: stored(networks.weights[name], coupling, w), seed: state.seed });
  };

  change({});
  const stop = animate(plane.canvas, (seconds) => {
    if (!play.playing) return;
    handle.time = (handle.time + seconds) % (SECONDS + REST);
    paintPlane();
  });
  const watch = new ResizeObserver(paint);
  watch.observe(figures);
  handle.stop = () => {
    stop();
    watch.disconnect();
  };
  return handle;
}
