/** Random numbers with a seed: the same seed draws the same noise in every browser. */

export class Random {
  constructor(seed) {
    this.state = seed >>> 0;
  }

  /** A number in [0, 1), by the generator mulberry32. */
  uniform() {
    this.state = (this.state + 0x6d2b79f5) >>> 0;
    let z = this.state;
    z = Math.imul(z ^ (z >>> 15), z | 1);
    z ^= z + Math.imul(z ^ (z >>> 7), z | 61);
    return ((z ^ (z >>> 14)) >>> 0) / 2 ** 32;
  }

  /** A whole number from 0 to n - 1. */
  below(n) {
    return Math.floor(this.uniform() * n);
  }

  /** n standard normal numbers (Box and Muller 1958). */
  normals(n) {
    const found = new Float64Array(n);
    for (let i = 0; i < n; i++) {
      const radius = Math.sqrt(-2 * Math.log(1 - this.uniform()));
      found[i] = radius * Math.cos(2 * Math.PI * this.uniform());
    }
    return found;
  }

  /** The numbers 0 .. n - 1 in a random order. */
  permutation(n) {
    const order = Int32Array.from({ length: n }, (_, i) => i);
    for (let i = n - 1; i > 0; i--) {
      const j = this.below(i + 1);
      [order[i], order[j]] = [order[j], order[i]];
    }
    return order;
  }
}
