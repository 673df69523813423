// Columns of numbers from the studio's server: the bytes of studio/columns.py. Must not know who shows them.

/**
 * @template H
 * @typedef {{ head: H, times: Float64Array, columns: Map<string, Float32Array> }} Columns
 */

/** @typedef {Record<string, string | number | boolean | null | undefined>} Query */

/**
 * Fetch columns.
 * @template {keyof Heads} A
 * @param {A} address
 * @param {Query} query
 * @returns {Promise<Columns<Heads[A]>>}
 * @throws {Error} with the server's words
 */
export async function fetchColumns(address, query = {}) {
  return parseColumns(await (await ask(withQuery(address, query))).arrayBuffer());
}

/**
 * @param {string} address
 * @param {Query} query
 */
export function withQuery(address, query) {
  const known = Object.entries(query).flatMap(([name, value]) => (value === undefined || value === null || value === "" ? [] : [[name, String(value)]]));
  return known.length ? `${address}?${new URLSearchParams(known)}` : address;
}

/**
 * Fetch from the studio.
 * @returns {Promise<Response>}
 * @throws {Error} with the server's words, if it refuses
 * @param {string} address
 * @param {RequestInit} [options]
 */
export async function ask(address, options) {
  const answer = await fetch(address, options);
  const json = (answer.headers.get("content-type") || "").startsWith("application/json");
  const said = json ? await answer.clone().json() : {};
  if (said.refused || !answer.ok) throw new Error(said.refused || `the studio answered ${answer.status}`);
  return answer;
}

/**
 * @param {ArrayBuffer} bytes
 * @returns {Columns<any>} what the head has besides count and columns depends on the address
 */
export function parseColumns(bytes) {
  const view = new DataView(bytes);
  if (view.getUint32(0, false) !== 0x48574331) throw new Error("the studio sent something else than columns");
  const size = view.getUint32(4, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 8, size)));
  let at = 8 + size;
  const times = new Float64Array(bytes, at, head.count);
  at += 8 * head.count;
  const columns = new Map();
  for (const name of head.columns) {
    columns.set(name, new Float32Array(bytes, at, head.count));
    at += 4 * head.count;
  }
  return { head, times, columns };
}

/**
 * Save what an address gives as a file, under the name that the server gives it.
 * @param {string} address
 * @param {Query} query
 */
export async function save(address, query) {
  const answer = await ask(withQuery(address, query));
  const said = answer.headers.get("content-disposition") || "";
  const name = decodeURIComponent((said.match(/filename\*=(?:utf-8|UTF-8)''([^;]+)/) || said.match(/filename="([^"]+)"/) || ["", "hexwire"])[1]);
  const link = document.createElement("a");
  link.href = URL.createObjectURL(await answer.blob());
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}
