"use strict";
// What the page holds deflated, in base64: JSON behind its length, then the arrays that {raw: [from, length]} names.
async function unpacked(id) {
  const text = atob(document.getElementById(id).textContent.trim());
  const bytes = Uint8Array.from(text, (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const all = await new Response(stream).arrayBuffer(), first = 4 + new DataView(all).getUint32(0, true);
  const array = (key, value) => (value && value.raw ? all.slice(first + value.raw[0], first + value.raw[0] + value.raw[1]) : value);
  return JSON.parse(new TextDecoder().decode(new Uint8Array(all, 4, first - 4)), first < all.byteLength ? array : undefined);
}
