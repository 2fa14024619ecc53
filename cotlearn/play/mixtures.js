/** The course's mixtures p(x | c) in the plane, from the table that the library exports. */

/**
 * Draw n rows.
 *
 * @param {object} mixture - `means` (conditions, modes, 2), `std`, and `labelled`: whether c is a
 *   label (one-hot) or a number in [-1, 1], over which the conditions of `means` are spread evenly.
 * @param {number} n - rows.
 * @param {Random} random - source of randomness.
 * @returns {{x1, c, k, value}} data (n, 2), conditions (n, k), and one number a condition (n,): its
 *   label, or c itself.
 */
export function draw(mixture, n, random) {
  const all = mixture.means.length;
  const value = Float64Array.from({ length: n }, () =>
    mixture.labelled ? random.below(all) : 2 * random.uniform() - 1,
  );
  return { x1: drawGiven(mixture, value, random), value, ...conditions(mixture, value) };
}

/** Conditions c (n, k) from one number each: one-hot labels, or the number itself. */
export function conditions(mixture, value) {
  if (!mixture.labelled) return { c: Float64Array.from(value), k: 1 };
  const k = mixture.means.length;
  const c = new Float64Array(value.length * k);
  value.forEach((label, i) => (c[i * k + label] = 1));
  return { c, k };
}

/** One x of p(x | c) for each condition, (n, 2); `even` takes the modes in turn, not at random. */
export function drawGiven(mixture, value, random, even = false) {
  const x = random.normals(2 * value.length);
  value.forEach((condition, i) => {
    const modes = meansAt(mixture, condition);
    const mode = modes[even ? i % modes.length : random.below(modes.length)];
    for (let k = 0; k < 2; k++) x[2 * i + k] = mode[k] + mixture.std * x[2 * i + k];
  });
  return x;
}

/** The means (modes, 2) under a condition; between two numbers of the table, on the line. */
export function meansAt(mixture, condition) {
  if (mixture.labelled) return mixture.means[condition];
  const place = ((condition + 1) / 2) * (mixture.means.length - 1);
  const low = Math.min(Math.floor(place), mixture.means.length - 2);
  const [a, b, share] = [mixture.means[low], mixture.means[low + 1], place - low];
  return a.map((mode, m) => mode.map((x, k) => (1 - share) * x + share * b[m][k]));
}

/** The conditions to look at: all labels, or nine numbers from -1 to 1. */
export function shownConditions(mixture) {
  if (mixture.labelled) return mixture.means.map((_, label) => label);
  return Array.from({ length: 9 }, (_, i) => ((i + 0.5) / 9) * 2 - 1);
}
