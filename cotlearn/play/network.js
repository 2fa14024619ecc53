/** A small velocity network v(t, x, c), as `cotlearn.flows.networks.VelocityMLP`, and its paths. */

export class Network {
  /**
   * @param {Float32Array} weights - matrices (out, in) and biases of all layers, in turn.
   * @param {number[]} sizes - columns of the input (t, x, c), of each hidden layer, of the output.
   */
  constructor(weights, sizes) {
    this.sizes = sizes;
    this.layers = [];
    weights = Float64Array.from(weights); // sums of these are faster
    let start = 0;
    for (let layer = 1; layer < sizes.length; layer++) {
      const [into, out] = [sizes[layer - 1], sizes[layer]];
      const matrix = weights.subarray(start, (start += into * out));
      this.layers.push({ matrix, bias: weights.subarray(start, (start += out)), into, out });
    }
    if (start !== weights.length) throw new Error("the weights of a network are damaged");
    this.values = sizes.map((size) => new Float64Array(size));
  }

  /** The velocity of one row, for x at `x[at]` and c at `c[from]`; the output layer's values. */
  velocity(t, x, at, c, from) {
    const input = this.values[0];
    input[0] = t;
    input[1] = x[at];
    input[2] = x[at + 1];
    for (let k = 3; k < input.length; k++) input[k] = c[from + k - 3];
    this.layers.forEach(({ matrix, bias, into, out }, layer) => {
      const [given, found] = [this.values[layer], this.values[layer + 1]];
      const last = layer === this.layers.length - 1;
      for (let j = 0, w = 0; j < out; j++) {
        let [sum, other, i] = [bias[j], 0, 0];
        for (; i + 1 < into; i += 2, w += 2) {
          sum += matrix[w] * given[i]; // two sums at once do not wait for each other
          other += matrix[w + 1] * given[i + 1];
        }
        for (; i < into; i++, w++) sum += matrix[w] * given[i];
        sum += other;
        found[j] = last ? sum : sum / (1 + Math.exp(-sum)); // SiLU
      }
    });
    return this.values[this.values.length - 1];
  }

  /**
   * Euler's method from noise at t = 0 to samples at t = 1.
   *
   * @param {Float64Array} x0 - (n, 2).
   * @param {Float64Array} c - (n, k).
   * @param {number} steps - evaluations.
   * @returns {Float64Array[]} the states (n, 2) at the times 0, 1/steps, ..., 1.
   */
  paths(x0, c, steps) {
    const n = x0.length / 2;
    const k = this.sizes[0] - 3;
    const states = [Float64Array.from(x0)];
    for (let step = 0; step < steps; step++) {
      const next = states[step].slice();
      for (let i = 0; i < n; i++) {
        const v = this.velocity(step / steps, states[step], 2 * i, c, i * k);
        next[2 * i] += v[0] / steps;
        next[2 * i + 1] += v[1] / steps;
      }
      states.push(next);
    }
    return states;
  }
}
