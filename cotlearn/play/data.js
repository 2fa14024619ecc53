/** Reads what Python packed: gzip, then base64, in an element of the page. */

/** The bytes of base64 text. */
export function bytes(text) {
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}

/** Numbers that Python wrote as little-endian float32 or int16, in base64. */
export function numbers(text, Kind = Float32Array) {
  return new Kind(bytes(text).buffer);
}

/**
 * The value of a packed text.
 *
 * @throws {Error} the text is damaged.
 */
export async function unpack(text) {
  try {
    const stream = new Blob([bytes(text.trim())]).stream();
    const plain = stream.pipeThrough(new DecompressionStream("gzip"));
    return JSON.parse(await new Response(plain).text());
  } catch (error) {
    throw new Error(`The data of this panel are damaged: load the page again (${error.message}).`);
  }
}
