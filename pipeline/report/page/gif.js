// Moving pictures: an episode as a GIF file (GIF89a, https://www.w3.org/Graphics/GIF/spec-gif89a.txt).

const GIF_SIZE = 300;
const GIF_STEP = 30; // Hundredths of a second that a state is shown.
const GIF_END = 150;

/** Return the GIF file of an episode as bytes: a frame for each state, for ever. */
function gifOf(labyrinth, states, withSight) {
  const canvas = document.createElement("canvas");
  const pencil = canvas.getContext("2d", { willReadFrequently: true });
  const frames = states.map((state) => {
    const view = { state };
    if (withSight) view.seen = visibleFrom(labyrinth, state % labyrinth.up.length);
    paint(canvas, labyrinth, GIF_SIZE, view);
    const image = pencil.getImageData(0, 0, canvas.width, canvas.height);
    return new Uint32Array(image.data.buffer);
  });
  const colours = [...new Set(frames.flatMap((frame) => [...new Set(frame)]))];
  // The pictures have flat colours, a dozen at most.
  const bits = Math.max(2, Math.ceil(Math.log2(colours.length)));
  const numbers = new Map(colours.map((colour, number) => [colour, number]));
  const word = (number) => [number & 255, number >> 8];
  const { width, height } = canvas;
  const bytes = [..."GIF89a"].map((letter) => letter.charCodeAt(0));
  bytes.push(...word(width), ...word(height), 0xf0 | (bits - 1), 0, 0);
  for (let number = 0; number < 1 << bits; number++) {
    const colour = colours[number] ?? 0; // As read from memory: red is the lowest byte.
    bytes.push(colour & 255, (colour >> 8) & 255, (colour >> 16) & 255);
  }
  // The extension by which browsers repeat an animation without end.
  bytes.push(0x21, 0xff, 11, ...[..."NETSCAPE2.0"].map((letter) => letter.charCodeAt(0)), 3, 1, 0, 0, 0);
  frames.forEach((frame, at) => {
    const shown = at === frames.length - 1 ? GIF_END : GIF_STEP;
    bytes.push(0x21, 0xf9, 4, 0, ...word(shown), 0, 0);
    bytes.push(0x2c, 0, 0, 0, 0, ...word(width), ...word(height), 0, bits);
    const packed = compressed(Array.from(frame, (colour) => numbers.get(colour)), bits);
    for (let from = 0; from < packed.length; from += 255) {
      const block = packed.slice(from, from + 255);
      bytes.push(block.length, ...block);
    }
    bytes.push(0);
  });
  bytes.push(0x3b);
  return new Uint8Array(bytes);
}

/** Return numbers of colours as GIF's variant of LZW writes them, in appendix F of its definition. */
function compressed(numbers, bits) {
  const clear = 1 << bits;
  const bytes = [];
  let [pending, filled, width, table, next] = [0, 0, bits + 1, new Map(), clear + 2];
  const write = (code) => {
    pending |= code << filled;
    for (filled += width; filled >= 8; filled -= 8, pending >>>= 8) bytes.push(pending & 255);
  };
  write(clear);
  let run = numbers[0];
  for (const number of numbers.slice(1)) {
    const longer = run * 256 + number;
    if (table.has(longer)) {
      run = table.get(longer);
      continue;
    }
    write(run);
    if (next === 4096) {
      write(clear);
      [width, table, next] = [bits + 1, new Map(), clear + 2];
    } else {
      if (next === 1 << width) width++;
      table.set(longer, next++);
    }
    run = number;
  }
  write(run);
  write(clear + 1);
  if (filled) bytes.push(pending & 255);
  return bytes;
}
