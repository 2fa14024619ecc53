/** A canvas with coordinates, in the colours of the course. */

/** The colours that change with the reader's theme. */
function theme(canvas) {
  const style = getComputedStyle(canvas);
  const get = (name) => style.getPropertyValue(name).trim();
  return { ink: get("--ink"), soft: get("--soft"), line: get("--line"), paper: get("--paper") };
}

const channels = (color) => [1, 3, 5].map((at) => parseInt(color.slice(at, at + 2), 16));

/** Relative luminance of #rrggbb (WCAG 2). */
function luminance(color) {
  const [r, g, b] = channels(color).map((value) => {
    const share = value / 255;
    return share <= 0.04045 ? share / 12.92 : ((share + 0.055) / 1.055) ** 2.4;
  });
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
}

/** The colour, moved towards the ink until it stands out from the paper by 3 to 1. */
export function visible(color, { paper, ink }) {
  const contrast = (a, b) => {
    const [low, high] = [luminance(a), luminance(b)].sort((x, y) => x - y);
    return (high + 0.05) / (low + 0.05);
  };
  const target = channels(ink);
  for (let moved = color; ; ) {
    if (contrast(moved, paper) >= 3 || moved === ink) return moved;
    const mixed = channels(moved).map((value, i) => {
      const step = (target[i] - value) * 0.12;
      return value + (step > 0 ? Math.ceil(step) : Math.floor(step));
    });
    moved = "#" + mixed.map((value) => value.toString(16).padStart(2, "0")).join("");
  }
}

/** A canvas whose coordinates are those of the data; one unit is as long in x as in y. */
export class Plane {
  /**
   * @param {HTMLElement} parent - gets the canvas.
   * @param {string} label - what the canvas shows, for those who cannot see it.
   * @param {number} shape - its height as a share of its width.
   */
  constructor(parent, label, shape = 1) {
    this.canvas = document.createElement("canvas");
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", label);
    this.shape = shape;
    this.box = [-1, 1, -1, 1];
    this.margin = [6, 6, 6, 6];
    parent.append(this.canvas);
    this.pen = this.canvas.getContext("2d");
    this.shades = new Map();
  }

  /** Show x from box[0] to box[1] and y from box[2] to box[3]; leave a margin in pixels. */
  frame(box, margin = [6, 6, 6, 6]) {
    this.box = box;
    this.margin = margin;
  }

  /** Empty the canvas; fit it to the place that the page gives it. */
  clear() {
    const ratio = window.devicePixelRatio || 1;
    this.width = this.canvas.clientWidth || 300;
    this.height = Math.round(this.width * this.shape);
    const [wide, high] = [Math.round(this.width * ratio), Math.round(this.height * ratio)];
    if (this.canvas.width !== wide || this.canvas.height !== high) {
      this.canvas.width = wide;
      this.canvas.height = high;
    }
    this.pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.pen.clearRect(0, 0, this.width, this.height);
    this.pen.globalAlpha = 1;
    const now = theme(this.canvas);
    if (this.theme?.paper !== now.paper) this.shades.clear();
    this.theme = now;
  }

  x(value) {
    const [low, high] = this.box;
    const [, right, , left] = this.margin;
    return left + ((value - low) / (high - low)) * (this.width - left - right);
  }

  y(value) {
    const [, , low, high] = this.box;
    const [top, , bottom] = this.margin;
    return top + ((high - value) / (high - low)) * (this.height - top - bottom);
  }

  /** The point [x, y] under a pointer event. */
  at(event) {
    const place = this.canvas.getBoundingClientRect();
    const [low, high, bottom, top] = this.box;
    const [above, right, below, left] = this.margin;
    const across = (event.clientX - place.left - left) / (this.width - left - right);
    const down = (event.clientY - place.top - above) / (this.height - above - below);
    return [low + across * (high - low), top - down * (top - bottom)];
  }

  /** A colour of the course that can be seen in this theme. */
  shade(color) {
    if (!this.shades.has(color)) this.shades.set(color, visible(color, this.theme));
    return this.shades.get(color);
  }

  dot(x, y, radius, color, alpha = 1) {
    this.pen.globalAlpha = alpha;
    this.pen.fillStyle = color;
    this.pen.beginPath();
    this.pen.arc(this.x(x), this.y(y), radius, 0, 7);
    this.pen.fill();
  }

  ring(x, y, radius, color, width = 2) {
    this.pen.globalAlpha = 1;
    this.pen.strokeStyle = color;
    this.pen.lineWidth = width;
    this.pen.beginPath();
    this.pen.arc(this.x(x), this.y(y), radius, 0, 7);
    this.pen.stroke();
  }

  /** A line through points [x, y]. */
  line(points, color, width = 1, alpha = 1, dash = []) {
    this.pen.globalAlpha = alpha;
    this.pen.strokeStyle = color;
    this.pen.lineWidth = width;
    this.pen.setLineDash(dash);
    this.pen.beginPath();
    for (const [x, y] of points) this.pen.lineTo(this.x(x), this.y(y));
    this.pen.stroke();
    this.pen.setLineDash([]);
  }

  /** An area within points [x, y], and its outline if it has one. */
  area(points, fill, outline = null) {
    this.pen.globalAlpha = 1;
    this.pen.beginPath();
    for (const [x, y] of points) this.pen.lineTo(this.x(x), this.y(y));
    this.pen.closePath();
    if (fill) {
      this.pen.fillStyle = fill;
      this.pen.fill();
    }
    if (outline) {
      this.pen.strokeStyle = outline;
      this.pen.lineWidth = 1.5;
      this.pen.stroke();
    }
  }

  text(words, x, y, { color = this.theme.soft, align = "center", bold = false, dx = 0, dy = 0 } = {}) {
    this.pen.globalAlpha = 1;
    this.pen.fillStyle = color;
    this.pen.font = `${bold ? "600 " : ""}12px system-ui, sans-serif`;
    this.pen.textAlign = align;
    this.pen.textBaseline = "middle";
    this.pen.fillText(words, this.x(x) + dx, this.y(y) + dy);
  }

  /** Axes of a chart, with words and numbers at them. */
  axes({ xTicks, yTicks, xLabel, yLabel, form = String }) {
    const [left, right, bottom, top] = this.box;
    const { line, soft } = this.theme;
    for (const y of yTicks) {
      this.line([[left, y], [right, y]], line, 1);
      this.text(form(y), left, y, { align: "right", dx: -5 });
    }
    for (const [x, words] of xTicks) this.text(words, x, bottom, { dy: 12 });
    this.line([[left, top], [left, bottom], [right, bottom]], soft, 1);
    this.text(xLabel, right, bottom, { align: "right", dy: 28 });
    this.text(yLabel, left, top, { align: "left", dx: -24, dy: -12 });
  }
}

/** Look up the colour of a condition: a label's own, or a number's place on the colour map. */
export function conditionColor(style, labelled, value) {
  if (labelled) return style.conditions[value % style.conditions.length];
  const place = Math.round(((value + 1) / 2) * (style.map.length - 1));
  return style.map[Math.max(0, Math.min(style.map.length - 1, place))];
}

/**
 * Call `draw(seconds)` in every frame in which the element can be seen.
 *
 * @returns {function} stops it.
 */
export function animate(element, draw) {
  let seen = true;
  let last = null;
  let stopped = false;
  const watcher = new IntersectionObserver(([entry]) => (seen = entry.isIntersecting));
  watcher.observe(element);
  const frame = (now) => {
    if (stopped) return;
    const passed = last === null ? 0 : Math.min(0.1, (now - last) / 1000);
    last = now;
    if (seen && !document.hidden) draw(passed);
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
  return () => {
    stopped = true;
    watcher.disconnect();
  };
}

/** Whether the reader asked for little movement. */
export const still = () => matchMedia("(prefers-reduced-motion: reduce)").matches;
