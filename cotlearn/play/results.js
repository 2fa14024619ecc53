/** Panel 4: the table of everything that was trained; filter, sort, compare, take along. */

import { button, make, sentence } from "./controls.js";
import { Plane } from "./drawing.js";

const FILTERS = [
  ["task", "task", "Task"],
  ["regime", "regime", "Decides"],
  ["method", "method", "Method"],
  ["nfe", "evaluations", "Evaluations"],
  ["setting", "setting", "Setting"],
  ["course", "course", "Protocol"],
];
const WORDS = { course: { 1: "the course's", 0: "others" } };
const AT_ONCE = 60; // rows of the table before "more"
const NAMED = 7; // curves of the chart that get a name

/** A column's value in a row: text, a number, or null where the table has none. */
export function valueOf(column, row) {
  return column.words ? (column.words[column.values[row]] ?? null) : column.values[row];
}

/** The rows (numbers of them) whose values are those of the filter; "" and undefined take all. */
export function filterRows(columns, wanted) {
  const tests = Object.entries(wanted).filter(([, value]) => value !== "" && value !== undefined);
  const count = Object.values(columns)[0].values.length;
  const all = Array.from({ length: count }, (_, row) => row);
  return all.filter((row) =>
    tests.every(([name, value]) => String(valueOf(columns[name], row)) === String(value)),
  );
}

/** The rows sorted by a column; rows without a value come last. */
export function sortRows(columns, rows, name, falling) {
  const value = (row) => valueOf(columns[name], row);
  return [...rows].sort((a, b) => {
    const [x, y] = [value(a), value(b)];
    if (x === null || y === null) return (x === null) - (y === null);
    const order = typeof x === "string" ? x.localeCompare(y) : x - y;
    return falling ? -order : order;
  });
}

/** The rows as CSV. */
export function toCsv(columns, rows) {
  const quoted = (value) => (/[",\n]/.test(value) ? `"${value.replaceAll('"', '""')}"` : value);
  const line = (cells) => cells.map((cell) => quoted(String(cell ?? ""))).join(",");
  const names = Object.keys(columns);
  const body = rows.map((row) => line(names.map((name) => valueOf(columns[name], row))));
  return [line(names), ...body].join("\n") + "\n";
}

/** Mean success of each method at each number of evaluations: method -> [[nfe, mean, rows], ...]. */
export function curves(columns, rows) {
  const groups = new Map();
  for (const row of rows) {
    const [success, nfe] = [valueOf(columns.success, row), valueOf(columns.evaluations, row)];
    if (success === null || nfe === null) continue;
    const method = valueOf(columns.method, row);
    if (!groups.has(method)) groups.set(method, new Map());
    const group = groups.get(method);
    group.set(nfe, [...(group.get(nfe) ?? []), success]);
  }
  const mean = (values) => values.reduce((a, b) => a + b, 0) / values.length;
  return new Map(
    [...groups].map(([method, group]) => [
      method,
      [...group].sort((a, b) => a[0] - b[0]).map(([nfe, all]) => [nfe, mean(all), all.length]),
    ]),
  );
}

export function mount(parent, { style, columns, link }) {
  const defaults = { task: "push-t", regime: "", method: "", nfe: "", setting: "", course: "1" };
  Object.assign(defaults, { sort: "success", falling: "true" });
  const state = link.read(defaults);
  const handle = { state, columns, rows: [] };
  let shown = AT_ONCE;
  const label = (method) => style.looks[method]?.label ?? method.replaceAll("_", "-");
  const wanted = (without = "") =>
    Object.fromEntries(
      FILTERS.filter(([key]) => key !== without).map(([key, name]) => [name, state[key]]),
    );

  const said = sentence(parent);
  const controls = make("div", { class: "controls" });
  parent.append(controls);
  const selects = FILTERS.map(([key, name, title]) => {
    const select = make("select", { name: key });
    select.addEventListener("change", () => change({ [key]: select.value }));
    controls.append(make("label", { class: "filter" }, make("span", {}, title), select));
    return { key, name, select };
  });
  const buttons = make("div", { class: "buttons" });
  controls.append(buttons);
  button(buttons, "All rows", () => {
    change(Object.fromEntries(FILTERS.map(([key]) => [key, ""])));
  });
  button(buttons, "Download CSV", download);
  const figure = make("figure", {}, make("figcaption", {}, "Success against evaluations"));
  parent.append(figure);
  const chart = new Plane(figure, "Success against evaluations", 0.42);
  const names = make("ul", { class: "names" }); // where the chart is too narrow for them
  figure.append(names);
  const table = make("table");
  parent.append(make("div", { class: "scroll", tabindex: 0, "aria-label": "Table" }, table));
  const more = button(parent, "Show more rows", () => {
    shown += AT_ONCE;
    fill();
  });

  function change(choices) {
    Object.assign(state, choices);
    shown = AT_ONCE;
    link.write(state, defaults);
    refresh();
  }

  function refresh() {
    if (!(state.sort in columns)) state.sort = defaults.sort;
    const rows = filterRows(columns, wanted());
    handle.rows = sortRows(columns, rows, state.sort, state.falling === "true");
    for (const { key, name, select } of selects) offer(key, name, select);
    parent.dataset.rows = rows.length;
    handle.curves = curves(columns, rows);
    describe();
    fill();
    paint();
  }

  /** The values that the other filters leave, each with its number of rows. */
  function offer(key, name, select) {
    const counts = new Map();
    for (const row of filterRows(columns, wanted(key))) {
      const value = valueOf(columns[name], row);
      if (value !== null) counts.set(value, (counts.get(value) ?? 0) + 1);
    }
    if (state[key] !== "" && ![...counts.keys()].some((value) => String(value) === state[key])) {
      counts.set(state[key], 0); // what was chosen stays to be seen
    }
    const words = (value) => (key === "method" ? label(value) : (WORDS[key]?.[value] ?? value));
    const order = (a, b) => (typeof a === "number" ? a - b : String(a).localeCompare(String(b)));
    const options = [...counts.keys()].sort(order).map((value) =>
      make("option", { value }, `${words(value)} (${counts.get(value)})`),
    );
    select.replaceChildren(make("option", { value: "" }, "all"), ...options);
    select.value = state[key];
  }

  function describe() {
    const count = handle.rows.length;
    if (!count) {
      said.textContent = "No row has all of these values: set one filter to “all”.";
      return;
    }
    const evaluated = (curve) => curve.find(([nfe]) => nfe > 0) ?? curve[0]; // a look-up has none
    const nfe = Math.min(...[...handle.curves.values()].map((curve) => evaluated(curve)[0]));
    const first = [...handle.curves]
      .map(([method, curve]) => [method, curve.find(([each]) => each === nfe)?.[1]])
      .filter(([, success]) => success !== undefined)
      .sort((a, b) => b[1] - a[1]);
    const share = (value) => `${Math.round(100 * value)} %`;
    const times = { 0: "no evaluation", 1: "one evaluation" }[nfe] ?? `${nfe} evaluations`;
    const best = first.length
      ? ` Success at ${times}: ${label(first[0][0])} ${share(first[0][1])}` +
        (first.length > 1
          ? ` (the most) to ${label(first.at(-1)[0])} ${share(first.at(-1)[1])} (means of these rows).`
          : ".")
      : "";
    said.textContent = `${count} ${count === 1 ? "row" : "rows"}.${best}`;
  }

  function fill() {
    const names = Object.keys(columns);
    const head = names.map((name) => {
      const sorted = state.sort === name;
      const mark = sorted ? (state.falling === "true" ? " ↓" : " ↑") : "";
      const press = make("button", { type: "button" }, name.replaceAll("_", " ") + mark);
      press.addEventListener("click", () => {
        const falling = sorted ? String(state.falling !== "true") : "true";
        change({ sort: name, falling });
      });
      const order = state.falling === "true" ? "descending" : "ascending";
      return make("th", { scope: "col", ...(sorted ? { "aria-sort": order } : {}) }, press);
    });
    const body = handle.rows.slice(0, shown).map((row) =>
      make("tr", {}, ...names.map((name) => make("td", {}, form(name, valueOf(columns[name], row))))),
    );
    table.replaceChildren(make("thead", {}, make("tr", {}, ...head)), make("tbody", {}, ...body));
    more.hidden = handle.rows.length <= shown;
  }

  const form = (name, value) =>
    value === null ? "" : name === "method" ? label(value) : String(value);

  function paint() {
    const marks = [1, 2, 4, 8, 16, 32, 100];
    const all = [...handle.curves.values()].flat().map(([nfe]) => nfe);
    const log = Math.log2;
    const [low, high] = [0, log(Math.max(16, ...all))];
    const wide = (chart.canvas.clientWidth || 300) > 500;
    chart.shape = wide ? 0.42 : 1;
    chart.frame([low - 0.2, high + (wide ? 0.2 : 0.4), 0, 1], [30, wide ? 190 : 12, 40, 44]);
    chart.clear();
    chart.axes({
      xTicks: marks.filter((nfe) => log(nfe) <= high).map((nfe) => [log(nfe), String(nfe)]),
      yTicks: [0, 0.25, 0.5, 0.75, 1],
      form: (y) => `${100 * y} %`,
      xLabel: "evaluations of the network",
      yLabel: "success",
    });
    const last = (curve) => curve.at(-1)[1];
    const sorted = [...handle.curves].sort((a, b) => last(b[1]) - last(a[1]));
    let above = -Infinity;
    names.replaceChildren();
    sorted.forEach(([method, curve], place) => {
      const color = chart.shade(style.looks[method]?.color ?? "#777777");
      if (!wide) {
        const percent = `${Math.round(100 * last(curve))} %`;
        names.append(make("li", { style: `border-color: ${color}` }, `${label(method)}, ${percent}`));
      }
      chart.line(curve.map(([nfe, mean]) => [log(nfe), mean]), color, 2, 0.85);
      for (const [nfe, mean] of curve) chart.dot(log(nfe), mean, 3.5, color);
      if (!wide || place >= 2 * NAMED) return;
      const y = Math.max(chart.y(last(curve)), above + 14);
      above = y;
      const dy = y - chart.y(last(curve));
      const dx = 10 + chart.x(chart.box[1]) - chart.x(log(curve.at(-1)[0]));
      chart.text(label(method), log(curve.at(-1)[0]), last(curve), { color, align: "left", dx, dy });
    });
    chart.canvas.setAttribute("aria-label", said.textContent);
  }

  function download() {
    const file = new Blob([toCsv(columns, handle.rows)], { type: "text/csv" });
    const anchor = make("a", { href: URL.createObjectURL(file), download: "cotlearn_results.csv" });
    anchor.click();
    setTimeout(() => URL.revokeObjectURL(anchor.href), 1000);
  }

  refresh();
  const watch = new ResizeObserver(paint);
  watch.observe(figure);
  handle.stop = () => watch.disconnect();
  return handle;
}
