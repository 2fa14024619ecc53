/**
 * What a coupling does to the noise, as `cotlearn.diagnostics` measures it, and the distance of
 * samples. All matrices are flat, row by row.
 */

import { assign, squaredDistances } from "./assignment.js";

const NEIGHBOURS = 10; // for the one-step variance
const NEAR = 5; // for the skew

/** The columns of rows (n, d), centred. */
function centred(rows, d) {
  const n = rows.length / d;
  return Array.from({ length: d }, (_, k) => {
    const column = Float64Array.from({ length: n }, (_, i) => rows[i * d + k]);
    const mean = column.reduce((a, b) => a + b, 0) / n;
    return column.map((value) => value - mean);
  });
}

const dot = (a, b) => a.reduce((sum, value, i) => sum + value * b[i], 0);

/** Orthonormal columns with the same span, by Gram and Schmidt; dependent ones are dropped. */
function orthonormal(columns) {
  const basis = [];
  for (const column of columns) {
    let rest = column;
    for (let pass = 0; pass < 2; pass++) {
      for (const b of basis) {
        const along = dot(rest, b);
        rest = rest.map((value, i) => value - along * b[i]);
      }
    }
    const size = Math.sqrt(dot(rest, rest));
    if (size > 1e-6 * Math.sqrt(dot(column, column))) basis.push(rest.map((v) => v / size));
  }
  return basis;
}

/**
 * The share of the noise's variance that a regression on c explains (`linear_skew`): about 0 if
 * they are independent, 1 if c determines the noise.
 *
 * @param {Float64Array} x0 - (n, 2), noise.
 * @param {Float64Array} c - (n, k), the condition that it was paired with.
 */
export function explained(x0, c, k) {
  const n = x0.length / 2;
  const [noise, features] = [orthonormal(centred(x0, 2)), orthonormal(centred(c, k))];
  let share = 0;
  for (const a of noise) for (const b of features) share += dot(a, b) ** 2 / noise.length;
  return 1 - ((1 - share) * (n - 1)) / (n - features.length - 1);
}

/** Columns of rows (n, d), scaled so that the rows have a mean squared distance of 2. */
function unitVariance(rows, d) {
  const scaled = centred(rows, d).map((column) => {
    const std = Math.sqrt(dot(column, column) / column.length);
    return std > 0 ? column.map((value) => value / std) : null;
  });
  const varying = scaled.filter((column) => column);
  return varying.map((column) => column.map((value) => value / Math.sqrt(varying.length)));
}

/** The nearest rows of each row, nearest first; `columns` are the coordinates. */
function nearest(columns, count) {
  const n = columns[0].length;
  const found = new Int32Array(n * count);
  const distance = new Float64Array(count);
  for (let i = 0; i < n; i++) {
    distance.fill(Infinity);
    for (let j = 0; j < n; j++) {
      if (j === i) continue;
      let sum = 0;
      for (const column of columns) sum += (column[i] - column[j]) ** 2;
      if (sum >= distance[count - 1]) continue;
      let place = count - 1;
      for (; place > 0 && distance[place - 1] > sum; place--) {
        distance[place] = distance[place - 1];
        found[i * count + place] = found[i * count + place - 1];
      }
      distance[place] = sum;
      found[i * count + place] = j;
    }
  }
  return found;
}

/**
 * Whether noise depends on the condition in any way (the statistic of `prior_skew`): in one half
 * of the pairs the conditions are shuffled; the excess share of neighbours of the same half.
 *
 * @param {Int32Array} rows - (n,), a permutation: its second half is shuffled.
 * @param {Int32Array} shuffle - the permutation of that half.
 */
export function skew(x0, c, k, rows, shuffle) {
  const half = rows.length - shuffle.length;
  const reorder = (order) => (column) => Float64Array.from(order, (row) => column[row]);
  const mixed = rows.slice();
  shuffle.forEach((row, i) => (mixed[half + i] = rows[half + row]));
  const noise = unitVariance(x0, 2).map(reorder(rows));
  const condition = unitVariance(c, k).map(reorder(mixed));
  const near = nearest([...noise, ...condition], NEAR);
  let same = 0;
  near.forEach((j, place) => (same += j >= half === Math.floor(place / NEAR) >= half));
  return (2 * same) / near.length - 1;
}

/** E tr Var(x1 | x0, c) by nearest neighbours: the error that one step cannot avoid. */
export function oneStepVariance(x0, x1, c, k) {
  const near = nearest([...unitVariance(x0, 2), ...unitVariance(c, k)], NEIGHBOURS);
  const n = x0.length / 2;
  let total = 0;
  for (let i = 0; i < n; i++) {
    const group = [i, ...near.subarray(i * NEIGHBOURS, (i + 1) * NEIGHBOURS)];
    for (let d = 0; d < 2; d++) {
      const values = group.map((row) => x1[2 * row + d]);
      const mean = values.reduce((a, b) => a + b, 0) / values.length;
      total += values.reduce((sum, v) => sum + (v - mean) ** 2, 0) / NEIGHBOURS;
    }
  }
  return total / n;
}

/** The squared 2-Wasserstein distance of two samples (n, 2). */
export function squaredW2(a, b) {
  const n = a.length / 2;
  const cost = squaredDistances(a, b, 2);
  return assign(cost, n).reduce((sum, j, i) => sum + cost[i * n + j], 0) / n;
}
