// Unpacks planes of 16-bit integers: base64, deflate, low bytes before high bytes, each number
// the difference to its left neighbour.

const block = document.getElementById("pixels");
const content = block ? JSON.parse(block.textContent) : null;
const unpacked = new Map();

async function inflate(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Returns planes as one array, plane after plane, row after row. */
function planes(text, width, signed) {
  if (!unpacked.has(text)) {
    unpacked.set(text, inflate(text).then((bytes) => {
      const count = bytes.length / 2;
      const words = signed ? new Int16Array(count) : new Uint16Array(count);
      for (let index = 0; index < count; index += 1) {
        const change = bytes[index] | (bytes[count + index] << 8);
        words[index] = index % width ? words[index - 1] + change : change;
      }
      return words;
    }));
  }
  return unpacked.get(text);
}
