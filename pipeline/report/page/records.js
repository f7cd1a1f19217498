// The labyrinths and episodes of the datasets, each unpacked when it is shown.

const ARRAYS = { uint8: Uint8Array, uint16: Uint16Array, uint32: Uint32Array };

/** Return the bytes of a base64 text; not every browser has the fast method yet. */
const fromBase64 = (text) =>
  Uint8Array.fromBase64?.(text) ?? Uint8Array.from(atob(text), (char) => char.charCodeAt(0));

/** The tiles of all tasks, see `labyrinth.Tile`. */
const TILES = Object.values(DATA.tasks).flatMap(({ tiles }) => tiles);

/** Return the cells of a labyrinth that show a tile. */
const cellsOf = (labyrinth, { name, many }) =>
  many ? labyrinth[name] : labyrinth[name] === null ? [] : [labyrinth[name]];

/** One split of a dataset. */
class Block {
  constructor(dataset, split, first) {
    this.dataset = dataset;
    this.split = split;
    this.first = first; // The number of the first labyrinth, counted over all blocks.
    this.unpacked = new Map();
  }

  get count() {
    return this.split.shown;
  }

  column(name) {
    if (!this.unpacked.has(name)) {
      const { type, data } = this.split.columns[name];
      const bytes = fromBase64(data);
      const kind = ARRAYS[type];
      this.unpacked.set(name, kind ? new kind(bytes.buffer) : bytes);
    }
    return this.unpacked.get(name);
  }

  /** Return the bits of a labyrinth's cells, one byte per bit. */
  bits(name, index) {
    const cells = this.dataset.height * this.dataset.width;
    const stride = (cells + 7) >> 3;
    const bytes = this.column(name).subarray(index * stride, (index + 1) * stride);
    return Uint8Array.from({ length: cells }, (_, cell) => (bytes[cell >> 3] >> (cell & 7)) & 1);
  }

  hex(name, index) {
    const bytes = this.column(name).subarray(8 * index, 8 * index + 8);
    return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
  }

  /** Return the key of a labyrinth, as in `failuresOf`. */
  key(index) {
    return `${this.dataset.name} ${this.split.name} ${this.hex("id", index)}`;
  }

  labyrinth(index) {
    const { height, width, task } = this.dataset;
    const tiles = {};
    for (const { name, many } of TILES) {
      const isThere = name in this.split.columns;
      if (many) {
        const shown = isThere ? this.bits(name, index) : [];
        tiles[name] = [...shown.keys()].filter((cell) => shown[cell]);
      } else {
        tiles[name] = isThere ? this.column(name)[index] : null;
      }
    }
    return {
      height, width, task,
      up: this.bits("up", index),
      right: this.bits("right", index),
      start: this.column("start")[index],
      goal: this.column("goal")[index],
      ...tiles,
    };
  }

  /** Return the actions of each episode of a labyrinth. */
  episodes(index) {
    const [episodes, lengths] = [this.column("episodes"), this.column("length")];
    const sums = this.sums ??= this.sumsOf(episodes, lengths);
    const packed = this.column("actions");
    let [episode, step] = [sums.episodes[index], sums.steps[index]];
    return Array.from({ length: episodes[index] }, () => {
      const actions = Array.from({ length: lengths[episode] }, (_, offset) => {
        const at = step + offset;
        return (packed[at >> 2] >> (2 * (at & 3))) & 3;
      });
      step += lengths[episode];
      episode += 1;
      return actions;
    });
  }

  /** Return the offsets of each labyrinth's episodes and actions. */
  sumsOf(episodes, lengths) {
    const sums = { episodes: new Uint32Array(this.count), steps: new Uint32Array(this.count) };
    let [episode, step] = [0, 0];
    for (let index = 0; index < this.count; index++) {
      sums.episodes[index] = episode;
      sums.steps[index] = step;
      for (let left = episodes[index]; left; left--) step += lengths[episode++];
    }
    return sums;
  }
}

const BLOCKS = [];
for (const dataset of DATA.datasets) {
  for (const split of dataset.splits) {
    const last = BLOCKS.at(-1);
    BLOCKS.push(new Block(dataset, split, last ? last.first + last.count : 0));
  }
}

/** Return the block of a labyrinth, and its index in the block. */
function locate(number) {
  const block = BLOCKS.findLast((each) => each.first <= number && each.count);
  return [block, number - block.first];
}

/** Return whether id `index` of a column of 8-byte ids begins with these hexadecimal digits. */
function idBegins(bytes, index, digits) {
  for (let place = 0; place < digits.length; place++) {
    const byte = bytes[8 * index + (place >> 1)];
    if ((place & 1 ? byte & 15 : byte >> 4) !== digits[place]) return false;
  }
  return true;
}

/** Return the numbers of the labyrinths that match the filters. */
function select(filters) {
  const found = [];
  const digits = /^[0-9a-f]{0,16}$/.test(filters.id)
    ? Array.from(filters.id, (digit) => parseInt(digit, 16))
    : null;
  for (const block of BLOCKS) {
    const { dataset, split } = block;
    const wanted =
      digits &&
      (!filters.split || filters.split === split.name) &&
      (!filters.size || filters.size === sizeOf(dataset)) &&
      (!filters.task || filters.task === dataset.task);
    if (!wanted || !block.count) continue;
    const [moves, loops] = [block.column("moves"), block.column("loops")];
    const ids = digits.length ? ["id", "structure"].map((name) => block.column(name)) : null;
    for (let index = 0; index < block.count; index++) {
      const inside =
        moves[index] >= filters.minMoves && moves[index] <= filters.maxMoves &&
        loops[index] >= filters.minLoops && loops[index] <= filters.maxLoops &&
        (!ids || ids.some((bytes) => idBegins(bytes, index, digits))) &&
        (!filters.failed || filters.failed.has(block.key(index)));
      if (inside) found.push(block.first + index);
    }
  }
  return found;
}

const sizeOf = ({ height, width }) => `${height}x${width}`;
