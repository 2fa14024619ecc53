/** The exact assignment, and the couplings that are made of it. */

/**
 * The permutation p that minimises sum_i cost[i, p[i]], by shortest augmenting paths
 * (Kuhn 1955, Jonker and Volgenant 1987).
 *
 * @param {Float64Array} cost - (n, n), row by row.
 * @param {number} n - rows.
 * @returns {Int32Array} (n,), the column of each row.
 */
export function assign(cost, n) {
  const rowPrice = new Float64Array(n);
  const columnPrice = new Float64Array(n);
  const rowOf = new Int32Array(n).fill(-1); // of each column
  const shortest = new Float64Array(n);
  const before = new Int32Array(n); // the column before this one on the shortest path
  const seen = new Uint8Array(n);
  for (let first = 0; first < n; first++) {
    shortest.fill(Infinity);
    seen.fill(0);
    const path = []; // columns, in the order in which the path found them
    let row = first;
    let column = -1;
    for (;;) {
      let least = Infinity;
      let next = -1;
      for (let j = 0; j < n; j++) {
        if (seen[j]) continue;
        const reduced = cost[row * n + j] - rowPrice[row] - columnPrice[j];
        if (reduced < shortest[j]) {
          shortest[j] = reduced;
          before[j] = column;
        }
        if (shortest[j] < least) {
          least = shortest[j];
          next = j;
        }
      }
      rowPrice[first] += least;
      for (const j of path) {
        rowPrice[rowOf[j]] += least;
        columnPrice[j] -= least;
      }
      for (let j = 0; j < n; j++) if (!seen[j]) shortest[j] -= least;
      seen[next] = 1;
      column = next;
      if (rowOf[column] < 0) break;
      path.push(column);
      row = rowOf[column];
    }
    while (column >= 0) {
      rowOf[column] = before[column] < 0 ? first : rowOf[before[column]];
      column = before[column];
    }
  }
  const columnOf = new Int32Array(n);
  rowOf.forEach((row, column) => (columnOf[row] = column));
  return columnOf;
}

/** |a_i - b_j|^2 for all rows of a (n, d) and b (n, d), row by row; the result is (n, n). */
export function squaredDistances(a, b, d) {
  const n = a.length / d;
  const cost = new Float64Array(n * n);
  for (let i = 0; i < n; i++) {
    for (let j = 0; j < n; j++) {
      let sum = 0;
      for (let k = 0; k < d; k++) sum += (a[i * d + k] - b[j * d + k]) ** 2;
      cost[i * n + j] = sum;
    }
  }
  return cost;
}

/** The rows (n, d) in this order. */
export function take(rows, order, d) {
  const found = new Float64Array(order.length * d);
  order.forEach((row, i) => {
    for (let k = 0; k < d; k++) found[i * d + k] = rows[row * d + k];
  });
  return found;
}

/**
 * Pair a batch: noise row i meets data row pairs[i].
 *
 * The cost is |x0 - x1|^2 + w |c0 - c|^2, where c0 is a random permutation of the batch's c. At
 * w = 0 this is naive OT; at w = Infinity only equal conditions are paired. A weight of null
 * stands for the independent coupling, which pairs row i with row i.
 *
 * @param {{x0, x1, c, k, order}} batch - noise and data (n, 2), conditions (n, k), and the
 *   permutation that gives each row of noise its condition c0 = c[order].
 * @param {?number} weight - w.
 * @returns {Int32Array} (n,), the data row of each row of noise.
 */
export function pair(batch, weight) {
  const { x0, x1, c, k, order } = batch;
  const n = order.length;
  if (weight === null) return Int32Array.from({ length: n }, (_, i) => i);
  if (weight === Infinity) return pairWithin(batch);
  const cost = squaredDistances(x0, x1, 2);
  if (weight > 0) {
    const apart = squaredDistances(take(c, order, k), c, k);
    for (let i = 0; i < cost.length; i++) cost[i] += weight * apart[i];
  }
  return assign(cost, n);
}

/** w = infinity: one plan for each distinct condition. */
function pairWithin({ x0, x1, c, k, order }) {
  const groups = new Map();
  const group = (row) => {
    const key = c.subarray(row * k, row * k + k).join();
    if (!groups.has(key)) groups.set(key, { sources: [], targets: [] });
    return groups.get(key);
  };
  order.forEach((row, i) => group(row).sources.push(i));
  order.forEach((_, j) => group(j).targets.push(j));
  const found = new Int32Array(order.length);
  for (const { sources, targets } of groups.values()) {
    const cost = squaredDistances(take(x0, sources, 2), take(x1, targets, 2), 2);
    assign(cost, sources.length).forEach((j, i) => (found[sources[i]] = targets[j]));
  }
  return found;
}
