// A film as an animated GIF, which every browser and every page of text shows. Colours are chosen by median cut over all
// frames, for what lies left and right of a line apart. What does not change from one frame to the next is left transparent, so that a film from a camera at rest is
// small.

/** Colours left, where the depth's greys are, and right; one more place is for what does not change. */
const COLOURS = [96, 159];
const TRANSPARENT = 255;
/** Pixels that differ less than this on every channel have not changed. */
const SAME = 3;

/** Five bits of a channel, and six of green: 64 greys. */
const cell = (data, at) => ((data[at] >> 3) << 11) | ((data[at + 1] >> 2) << 5) | (data[at + 2] >> 3);

/** The colours of these columns of the frames: boxes of the colour cube are halved at their median, the most spread one
 * first. `first`: the number of the first of at most so many. */
function palette(frames, [from, to], colours, first, most) {
  const counts = new Uint32Array(1 << 16);
  const sums = new Float64Array(3 << 16);
  for (const { data, width } of frames) {
    for (let at = 0; at < data.length; at += 4) {
      const x = (at / 4) % width;
      if (x < from || x >= to) continue;
      const of = cell(data, at);
      counts[of] += 1;
      for (let channel = 0; channel < 3; channel += 1) sums[3 * of + channel] += data[at + channel];
    }
  }
  const mean = (of, channel) => sums[3 * of + channel] / counts[of];
  const measured = (cells) => {
    const spreads = [0, 1, 2].map((channel) => {
      const values = cells.map((of) => mean(of, channel));
      return values.reduce((most, value) => Math.max(most, value), 0) - values.reduce((least, value) => Math.min(least, value), 255);
    });
    const channel = spreads.indexOf(Math.max(...spreads));
    const weight = cells.reduce((sum, of) => sum + counts[of], 0);
    return { cells, channel, urgency: cells.length > 1 ? spreads[channel] * Math.sqrt(weight) : 0 };
  };
  let boxes = [measured([...counts.keys()].filter((of) => counts[of]))];
  while (boxes.length < most) {
    boxes.sort((a, b) => b.urgency - a.urgency);
    const [{ cells, channel, urgency }] = boxes;
    if (!urgency) break;
    cells.sort((a, b) => mean(a, channel) - mean(b, channel));
    const half = cells.reduce((sum, of) => sum + counts[of], 0) / 2;
    let [at, passed] = [0, 0];
    while (at < cells.length - 1 && (at === 0 || passed + counts[cells[at]] <= half)) { passed += counts[cells[at]]; at += 1; }
    boxes = [measured(cells.slice(0, at)), measured(cells.slice(at)), ...boxes.slice(1)];
  }
  const place = new Uint8Array(1 << 16);
  boxes.forEach(({ cells }, at) => {
    const index = first + at;
    const weight = cells.reduce((sum, of) => sum + counts[of], 0) || 1;
    for (let channel = 0; channel < 3; channel += 1) colours[3 * index + channel] = Math.round(cells.reduce((sum, of) => sum + sums[3 * of + channel], 0) / weight);
    for (const of of cells) place[of] = index;
  });
  return place;
}

/** Bytes that grow. */
class Bytes {
  constructor() { this.parts = []; }
  put(...bytes) { this.parts.push(Uint8Array.from(bytes)); }
  word(value) { this.put(value & 255, value >> 8); }
  text(text) { this.put(...[...text].map((letter) => letter.charCodeAt(0))); }
  all(bytes) { this.parts.push(bytes); }
}

/** LZW as GIF has it: codes of 9 to 12 bits, in blocks of up to 255 bytes. */
function compressed(pixels) {
  const [clear, end] = [256, 257];
  const out = [];
  let [buffer, bits, size, next] = [0, 0, 9, 258];
  let known = new Map();
  const emit = (code) => {
    buffer |= code << bits;
    bits += size;
    while (bits >= 8) { out.push(buffer & 255); buffer >>>= 8; bits -= 8; }
  };
  emit(clear);
  let prefix = pixels[0];
  for (let at = 1; at < pixels.length; at += 1) {
    const key = (prefix << 8) | pixels[at];
    const code = known.get(key);
    if (code !== undefined) { prefix = code; continue; }
    emit(prefix);
    prefix = pixels[at];
    if (next === 4096) { emit(clear); known = new Map(); [size, next] = [9, 258]; continue; }
    known.set(key, next);
    if (next === 1 << size) size += 1;
    next += 1;
  }
  emit(prefix);
  emit(end);
  if (bits) out.push(buffer & 255);
  const blocks = new Bytes();
  for (let at = 0; at < out.length; at += 255) {
    const block = out.slice(at, at + 255);
    blocks.put(block.length, ...block);
  }
  blocks.put(0);
  return blocks.parts;
}

/** The frames, `ImageData` of one size, as a GIF that begins again at its end. `seconds`: of each frame, the last stands
 * longer. `split`: the column from which on colours are others. */
export function gif(frames, seconds, split) {
  const [{ width, height }] = frames;
  const colours = new Uint8Array(3 * 256);
  const [left, right] = [[0, split], [split, width]].map((columns, side) => palette(frames, columns, colours, side * COLOURS[0], COLOURS[side]));
  const bytes = new Bytes();
  bytes.text("GIF89a");
  bytes.word(width);
  bytes.word(height);
  bytes.put(0xf7, 0, 0);
  bytes.all(colours);
  bytes.put(0x21, 0xff, 11);
  bytes.text("NETSCAPE2.0");
  bytes.put(3, 1, 0, 0, 0);
  // What is on the screen by now: a pixel that changes slowly must not stay what it was.
  const shown = new Uint8ClampedArray(frames[0].data.length);
  frames.forEach(({ data }, index) => {
    const pixels = new Uint8Array(width * height);
    for (let pixel = 0; pixel < pixels.length; pixel += 1) {
      const at = 4 * pixel;
      const same = index > 0 && Math.abs(data[at] - shown[at]) < SAME && Math.abs(data[at + 1] - shown[at + 1]) < SAME && Math.abs(data[at + 2] - shown[at + 2]) < SAME;
      if (same) { pixels[pixel] = TRANSPARENT; continue; }
      pixels[pixel] = (pixel % width < split ? left : right)[cell(data, at)];
      for (let channel = 0; channel < 3; channel += 1) shown[at + channel] = data[at + channel];
    }
    const hundredths = Math.round(100 * (index === frames.length - 1 ? Math.max(1.5, seconds) : seconds));
    bytes.put(0x21, 0xf9, 4, index ? 0x05 : 0x04);
    bytes.word(hundredths);
    bytes.put(TRANSPARENT, 0, 0x2c, 0, 0, 0, 0);
    bytes.word(width);
    bytes.word(height);
    bytes.put(0, 8);
    for (const part of compressed(pixels)) bytes.all(part);
  });
  bytes.put(0x3b);
  return new Blob(bytes.parts, { type: "image/gif" });
}
