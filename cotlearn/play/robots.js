/** Panel 3: recorded robots, method by method, from the same starts and with the same noise. */

import { button, choice, make, playButton, sentence, slider } from "./controls.js";
import { numbers } from "./data.js";
import { animate, conditionColor, Plane, still } from "./drawing.js";

const SPEEDS = [1, 4, 10];
const REST = 1.5; // seconds at the end
const [AZIMUTH, ELEVATION] = [-0.9, 0.5]; // of the view on the arm, radians
const TOOL = 0.26; // metres of the rod above the tip
const TITLES = { "push-t": "push the T", "arm-ring": "round the pillar" };

/** A packed run, opened: `state(episode, step)` and `chunk(episode, step)` are rows of numbers. */
export function openRun(run, scene) {
  const [states, chunks] = [numbers(run.states, Int16Array), numbers(run.chunks, Int16Array)];
  const [, times, columns] = run.shape;
  const [, count, predict, size] = run.chunkShape;
  if (states.length !== run.shape.reduce((a, b) => a * b)) throw new Error("a replay is damaged");
  return {
    ...run,
    state(episode, step) {
      const now = Math.min(step, run.steps[episode]);
      const start = (episode * times + now) * columns;
      const row = Array.from(states.subarray(start, start + columns), (v) => v / scene.scale);
      if (scene.turn) row[4] = (row[4] * scene.scale) / scene.turn;
      return row;
    },
    chunk(episode, step) {
      const last = Math.max(0, run.steps[episode] - 1);
      const number = Math.min(Math.floor(Math.min(step, last) / run.execute), count - 1);
      const start = (episode * count + number) * predict * size;
      return Array.from({ length: predict }, (_, i) =>
        Array.from(chunks.subarray(start + i * size, start + (i + 1) * size), (v) => v / scene.scale),
      );
    },
  };
}

/** How often each outcome came up, in words, the most frequent first. */
export function tally(outcomes) {
  const counts = new Map();
  for (const { words } of outcomes) counts.set(words, (counts.get(words) ?? 0) + 1);
  const sorted = [...counts].sort((a, b) => b[1] - a[1]);
  return sorted.map(([words, count]) => `${count} ${words.replace(/^hits/, "hit").replace(/^misses/, "miss")}`).join(", ");
}

export function mount(parent, { style, tasks, forty = null, link }) {
  const names = Object.keys(tasks);
  const defaults = { task: names[0], nfe: "1", start: 0, speed: 4, show: "replay" };
  const state = link.read(defaults);
  for (const name of ["start", "speed"]) state[name] = Number(state[name]) || 0;
  if (!names.includes(state.task)) state.task = defaults.task;
  if (!SPEEDS.includes(state.speed)) state.speed = defaults.speed;

  const handle = { state, time: 0 };
  const opened = new Map();
  let play, scrubber, planes, said;

  const task = () => tasks[state.task];
  const methods = () => Object.keys(task().runs);
  const counts = () => Object.keys(Object.values(task().runs)[0]);
  const label = (method) => style.looks[method]?.label ?? method;
  const many = () => state.show === "forty" && forty !== null && state.task === "arm-ring";

  /** The run that a method's figure shows. */
  function run(method) {
    const runs = many() ? forty : task().runs;
    const key = `${many()} ${state.task} ${method} ${state.nfe}`;
    if (!opened.has(key)) opened.set(key, openRun(runs[method][state.nfe], task().scene));
    return opened.get(key);
  }
  handle.run = run;

  const length = () => Math.max(...methods().map((method) => run(method).steps[state.start]));

  function change(choices) {
    const rebuild = "task" in choices || "show" in choices;
    Object.assign(state, choices);
    handle.time = 0;
    check();
    link.write(state, defaults);
    if (rebuild) build();
    else refresh();
  }

  function check() {
    if (!counts().includes(state.nfe)) state.nfe = counts()[0];
    const starts = Object.values(task().runs)[0][state.nfe].steps.length;
    if (!(state.start >= 0 && state.start < starts)) state.start = 0;
  }

  function build() {
    parent.replaceChildren();
    said = sentence(parent);
    const controls = make("div", { class: "controls" });
    parent.append(controls);
    if (names.length > 1) {
      const titles = names.map((name) => [name, TITLES[name] ?? name]);
      choice(controls, "Task", titles, state.task, (value) => change({ task: value }));
    }
    if (forty && state.task === "arm-ring") {
      const shows = [["replay", "one start"], ["forty", "forty draws"]];
      choice(controls, "Show", shows, state.show, (show) => change({ show }));
    }
    const evaluations = counts().map((nfe) => [nfe, nfe]);
    choice(controls, "Evaluations for each decision", evaluations, state.nfe, (nfe) => change({ nfe }));
    if (!many()) {
      const starts = Object.values(task().runs)[0][state.nfe].steps.map((_, i) => [i, String(i + 1)]);
      choice(controls, "Start", starts, state.start, (start) => change({ start }));
      const speeds = SPEEDS.map((speed) => [speed, `${speed} ×`]);
      choice(controls, "Speed", speeds, state.speed, (speed) => {
        state.speed = speed;
        link.write(state, defaults);
      });
      const seconds = (step) => `${(step * task().scene.seconds).toFixed(1)} s`;
      scrubber = slider(controls, "Time", 2, 0, seconds, (step) => {
        play.set(false);
        handle.time = step * task().scene.seconds;
        paint();
      });
    }
    const buttons = make("div", { class: "buttons" });
    controls.append(buttons);
    play = playButton(buttons, !still(), () => {});
    button(buttons, "Again", () => {
      handle.time = 0;
      paint();
    });
    const figures = make("div", { class: "figures columns" });
    parent.append(figures);
    planes = methods().map((method) => {
      const caption = make("figcaption", {}, label(method));
      const figure = make("figure", {}, caption);
      figures.append(figure);
      const plane = new Plane(figure, `Robot: ${label(method)}`, state.task === "push-t" ? 1 : 0.8);
      const words = make("p", { class: "outcome" });
      figure.append(words);
      return { method, plane, words };
    });
    refresh();
  }

  function refresh() {
    if (!many()) scrubber.input.max = length();
    said.textContent = describe();
    paint();
  }

  function describe() {
    const times = state.nfe === "1" ? "one evaluation" : `${state.nfe} evaluations`;
    if (many()) {
      const parts = methods().map((method) => `${label(method)}: ${tally(run(method).outcomes)}`);
      return `Forty draws from one start, ${times} each. ${parts.join("; ")}.`;
    }
    const parts = methods().map((method) => {
      const { good, words } = run(method).outcomes[state.start];
      return `${label(method)}: ${words}${good ? " ✓" : " ✗"}`;
    });
    return `Start ${state.start + 1}, ${times} for each decision. ${parts.join("; ")}.`;
  }

  // --- drawing

  function paint() {
    const step = Math.floor(handle.time / task().scene.seconds + 1e-9);
    for (const { method, plane, words } of planes) {
      const one = run(method);
      if (many()) {
        paintForty(plane, one);
        words.textContent = tally(one.outcomes);
        continue;
      }
      const { good, words: end } = one.outcomes[state.start];
      const over = step >= one.steps[state.start];
      words.textContent = over ? `${good ? "✓" : "✗"} ${end}` : "…";
      words.className = `outcome ${over ? (good ? "good" : "bad") : ""}`;
      const draw = state.task === "push-t" ? paintPush : paintArm;
      draw(plane, one, Math.min(step, one.steps[state.start]), method);
    }
  }

  function paintPush(plane, one, step, method) {
    const { size, goal, outline, radius } = task().scene;
    plane.frame([0, size, size, 0], [2, 2, 2, 2]);
    plane.clear();
    const { ink, line } = plane.theme;
    plane.area([[0, 0], [size, 0], [size, size], [0, size]], null, line);
    const tee = ([x, y, angle]) =>
      outline.map(([a, b]) => [
        x + Math.cos(angle) * a - Math.sin(angle) * b,
        y + Math.sin(angle) * a + Math.cos(angle) * b,
      ]);
    plane.area(tee(goal), style.goalArea);
    const now = one.state(state.start, step);
    plane.area(tee(now.slice(2)), style.block, ink);
    const color = plane.shade(style.looks[method]?.color ?? style.looks.independent.color);
    const chunk = one.chunk(state.start, step);
    plane.line([now.slice(0, 2), ...chunk], color, 1.2, 0.7);
    for (const [x, y] of chunk.slice(0, one.execute)) plane.dot(x, y, 2.2, color);
    plane.dot(now[0], now[1], (radius / size) * plane.width, color);
  }

  /** From the right and above: metres to the picture's units. */
  function project([x, y, z]) {
    const across = -Math.sin(AZIMUTH) * x + Math.cos(AZIMUTH) * y;
    const away = Math.cos(AZIMUTH) * x + Math.sin(AZIMUTH) * y;
    return [across, Math.cos(ELEVATION) * z - Math.sin(ELEVATION) * away];
  }

  /** Goal and pillar; the frame fits what lies around the pillar. */
  function paintWorld(plane, row) {
    const [px, py, radius, height] = row.slice(6, 10);
    const [cx, cy] = project([px, py, 0.1]);
    plane.frame([cx - 0.3, cx + 0.3, cy - 0.22, cy + 0.26], [2, 2, 2, 2]);
    plane.clear();
    const circle = (x, y, z, r) =>
      Array.from({ length: 33 }, (_, i) => {
        const turn = (i / 32) * 2 * Math.PI;
        return project([x + r * Math.cos(turn), y + r * Math.sin(turn), z]);
      });
    const { goalColor, pillarColor, reach } = task().scene;
    plane.line(circle(px, py, 0, 0.25), plane.theme.line, 1);
    const [gx, gy, gz] = row.slice(3, 6);
    plane.line([project([gx, gy, 0]), project([gx, gy, gz])], plane.theme.line, 1);
    plane.line(circle(gx, gy, gz, reach), plane.shade(goalColor), 3);
    const [foot, top] = [circle(px, py, 0, radius), circle(px, py, height, radius)];
    const sides = [...top.slice(0, 33), ...foot.slice(0, 33)];
    plane.area(hull(sides), pillarColor);
    plane.line(top, plane.theme.paper, 1, 0.8);
  }

  function paintArm(plane, one, step, method) {
    const row = one.state(state.start, step);
    paintWorld(plane, row);
    const color = plane.shade(style.looks[method]?.color ?? style.looks.independent.color);
    const chunk = one.chunk(state.start, step);
    plane.line(chunk.map(project), color, 1.5, 0.8, [3, 4]);
    const done = Array.from({ length: step + 1 }, (_, t) => one.state(state.start, t).slice(0, 3));
    plane.line(done.map(project), color, 3);
    const tip = row.slice(0, 3);
    const above = [tip[0], tip[1], tip[2] + TOOL];
    plane.line([project(tip), project(above)], plane.theme.ink, 5, 0.75);
    plane.dot(...project(tip), 5, color);
  }

  function paintForty(plane, one) {
    paintWorld(plane, one.state(0, 0));
    const share = still() && !play.playing ? 1 : Math.min(1, handle.time / 2.5);
    one.outcomes.forEach(({ good, mode }, episode) => {
      const end = Math.round(share * one.steps[episode]);
      const path = Array.from({ length: end + 1 }, (_, t) => project(one.state(episode, t)));
      const color = good ? plane.shade(conditionColor(style, true, mode)) : plane.theme.soft;
      plane.line(path, color, 1.6, 0.8, good ? [] : [3, 2]);
      const [x, y] = path.at(-1);
      if (good || end < one.steps[episode]) plane.dot(x, y, 2.5, color);
      else plane.text("×", x, y, { color: plane.theme.ink, bold: true });
    });
  }

  check();
  build();
  const stop = animate(parent, (seconds) => {
    if (!play.playing) return;
    if (many()) handle.time = (handle.time + seconds) % (2.5 + REST);
    else {
      const end = length() * task().scene.seconds;
      handle.time += state.speed * seconds;
      if (handle.time > end + REST * state.speed) handle.time = 0;
      scrubber.value = Math.min(Math.floor(handle.time / task().scene.seconds), length());
    }
    paint();
  });
  const watch = new ResizeObserver(() => paint());
  watch.observe(parent);
  handle.stop = () => {
    stop();
    watch.disconnect();
  };
  return handle;
}

/** The convex hull of points, by Andrew's monotone chain. */
export function hull(points) {
  const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  const turn = (o, a, b) => (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0]);
  const half = (some) => {
    const chain = [];
    for (const point of some) {
      while (chain.length > 1 && turn(chain.at(-2), chain.at(-1), point) <= 0) chain.pop();
      chain.push(point);
    }
    return chain.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
}
