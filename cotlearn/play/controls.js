/** The controls of a panel: each has a name in words, works by keyboard, and acts at once. */

/** Make an element; `children` are elements or words. */
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

let groups = 0;

/**
 * One of several values, as a row of buttons.
 *
 * @param {Array<[value, string]>} options - values and their words.
 * @returns {{value}} reads or sets the value; setting it does not call `changed`.
 */
export function choice(parent, label, options, value, changed) {
  const name = `choice-${groups++}`;
  const box = make("fieldset", { class: "choice" }, make("legend", {}, label));
  const inputs = options.map(([own, words]) => {
    const input = make("input", { type: "radio", name, value: own });
    input.addEventListener("change", () => changed(own));
    box.append(make("label", {}, input, make("span", {}, words)));
    return [own, input];
  });
  parent.append(box);
  const control = {
    get value() {
      return inputs.find(([, input]) => input.checked)?.[0];
    },
    set value(wanted) {
      for (const [own, input] of inputs) input.checked = own === wanted;
    },
    box,
  };
  control.value = value;
  return control;
}

/**
 * A slider over the places 0 .. count - 1; `words(place)` says what a place means.
 *
 * @returns {{value}} reads or sets the place; setting it does not call `changed`.
 */
export function slider(parent, label, count, place, words, changed) {
  const output = make("output", {}, words(place));
  const input = make("input", { type: "range", min: 0, max: count - 1, step: 1 });
  input.setAttribute("aria-label", label);
  const show = () => {
    output.textContent = words(Number(input.value));
    input.setAttribute("aria-valuetext", output.textContent);
  };
  input.addEventListener("input", () => {
    show();
    changed(Number(input.value));
  });
  const box = make("label", { class: "slider" }, make("span", {}, label, " ", output), input);
  parent.append(box);
  const control = {
    get value() {
      return Number(input.value);
    },
    set value(wanted) {
      input.value = wanted;
      show();
    },
    input,
    box,
  };
  control.value = place;
  return control;
}

/** A button. */
export function button(parent, words, pressed, kind = "") {
  const element = make("button", { type: "button", class: kind }, words);
  element.addEventListener("click", pressed);
  parent.append(element);
  return element;
}

/** A button that plays and pauses; `changed(playing)` is called. */
export function playButton(parent, playing, changed) {
  const words = (on) => (on ? "Pause" : "Play");
  const element = button(parent, words(playing), () => control.set(!control.playing));
  const control = {
    playing,
    set(on) {
      control.playing = on;
      element.textContent = words(on);
      changed(on);
    },
  };
  return control;
}

/** A figure: its words above, and the place of its canvas. */
export function figure(parent, title) {
  const box = make("figure", {}, make("figcaption", {}, title));
  parent.append(box);
  return box;
}

/** The sentence of a panel, which says in words what it shows; it is also read aloud. */
export function sentence(parent) {
  const element = make("p", { class: "sentence", "aria-live": "polite" });
  parent.append(element);
  return element;
}

/** Do the work when the browser has time, and only the newest of a kind. */
export class Later {
  constructor() {
    this.number = 0;
  }

  /** Run the steps one after the other, with a pause for the page between them. */
  run(steps) {
    const mine = ++this.number;
    const next = () => {
      if (mine !== this.number) return;
      const { done } = steps.next();
      if (!done) setTimeout(next, 0);
    };
    setTimeout(next, 0);
  }
}

/** What the arrow keys move a point by, in x and y. */
export const ARROWS = {
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  ArrowUp: [0, 1],
  ArrowDown: [0, -1],
};

/** Drag on a plane from where `takes(place)` says yes; elsewhere a finger scrolls the page. */
export function drag(plane, takes, moves) {
  const { canvas } = plane;
  let dragging = false;
  canvas.addEventListener("pointerdown", (event) => {
    const place = plane.at(event);
    if (!takes(place)) return;
    dragging = true;
    canvas.setPointerCapture(event.pointerId);
    event.preventDefault();
    moves(place);
  });
  canvas.addEventListener("pointermove", (event) => dragging && moves(plane.at(event)));
  for (const end of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(end, () => (dragging = false));
  }
  canvas.addEventListener("touchmove", (event) => dragging && event.preventDefault(), {
    passive: false,
  });
}
