// The text language: labyrinth_core.language.text and source_text, with the same messages.

const SETTINGS = {
  key_and_lock: "key_and_door",
  icy_floor: "icy_floor",
  occlusion: "partial_observability",
};
const LOOK = "look";
const LOOKS = ["plain", "recoloured", "thin_walls"];
const NAMES = [...Object.keys(SETTINGS), LOOK];
const VALUES = {
  ...Object.fromEntries(Object.keys(SETTINGS).map((name) => [name, /^(true|false)$/])),
  [LOOK]: new RegExp(`^(${LOOKS.join("|")})$`),
};
const EXPECTED = {
  ...Object.fromEntries(Object.keys(SETTINGS).map((name) => [name, "True or False"])),
  [LOOK]: `${LOOKS.slice(0, -1).join(", ")} or ${LOOKS.at(-1)}`,
};
const HEADING = "labyrinth";
const MAX_TEXT = 32 * 1024 * 1024;
const WINDOW = 94; // The longest part of a source line that a message shows, in characters.
const QUOTES = '"""';

const isPrintable = (char) => char === " " || !/[\p{C}\p{Z}]/u.test(char);
const trimBlanks = (text) => text.replace(/^ +| +$/g, "");
const trimEnd = (text) => text.replace(/ +$/, "");
const trimStart = (text) => text.replace(/^ +/, "");
const lineStart = (text, offset) => (offset ? text.lastIndexOf("\n", offset - 1) + 1 : 0);
const grouped = (number) => number.toLocaleString("en-US");

/** A text that is not a labyrinth; columns count characters, as in Python. */
class LabyrinthSyntaxError extends Error {
  constructor(text, offset, message, expected = null, found = null) {
    super(message);
    const from = lineStart(text, offset);
    const end = text.indexOf("\n", offset);
    this.sourceLine = text.slice(from, end < 0 ? text.length : end);
    this.line = text.slice(0, offset).split("\n").length;
    this.column = [...text.slice(from, offset)].length + 1;
    this.expected = expected;
    this.found = found;
  }

  /** The message without the place. */
  get what() {
    const expected = this.expected === null ? "" : `: expected ${this.expected}`;
    return this.message + expected + (this.found === null ? "" : `, found ${this.found}`);
  }

  /** The source line, with a caret below the place. */
  get shown() {
    const source = [...this.sourceLine];
    const column = this.column - 1;
    const start = Math.max(0, Math.min(column - WINDOW / 2, source.length - WINDOW));
    const before = start ? "..." : "";
    const after = start + WINDOW < source.length ? "..." : "";
    const shown = source.slice(start, start + WINDOW);
    const harmless = shown.map((char) => (isPrintable(char) ? char : "?")).join("");
    return `${before}${harmless}${after}\n${" ".repeat(before.length + column - start)}^`;
  }

  /** The whole message, as in Python. */
  full(file) {
    return `${file}:${this.line}:${this.column}: ${this.what}\n${this.shown}`;
  }
}

/** Return a text in quotation marks, as Python writes it. */
function pythonQuoted(text) {
  const mark = text.includes("'") && !text.includes('"') ? '"' : "'";
  const named = { "\n": "\\n", "\r": "\\r", "\t": "\\t", "\\": "\\\\", [mark]: `\\${mark}` };
  const written = [...text].map((char) => {
    if (char in named) return named[char];
    if (isPrintable(char)) return char;
    const hexadecimal = char.codePointAt(0).toString(16);
    if (hexadecimal.length <= 2) return `\\x${hexadecimal.padStart(2, "0")}`;
    const short = hexadecimal.length <= 4;
    return short ? `\\u${hexadecimal.padStart(4, "0")}` : `\\U${hexadecimal.padStart(8, "0")}`;
  });
  return mark + written.join("") + mark;
}

/** Return a word or a line in quotation marks, shortened if it is long. */
function quoted(text) {
  if (!text) return "the end of the text";
  const chars = [...text];
  return pythonQuoted(chars.slice(0, 30).join("")) + (chars.length > 30 ? "..." : "");
}

/** Return a description of the character at an offset of a text. */
function describe(text, offset) {
  if (offset >= text.length) return "the end of the text";
  const char = String.fromCodePoint(text.codePointAt(offset));
  const names = { "\n": "the end of the line", " ": "a blank", "\t": "a tab" };
  if (char in names) return names[char];
  const code = char.codePointAt(0).toString(16).toUpperCase().padStart(4, "0");
  return isPrintable(char) ? pythonQuoted(char) : `the character U+${code}`;
}

/** A text that is read line by line, without its comments. */
class Source {
  constructor(text) {
    if (text.length > MAX_TEXT) {
      const expected = `at most ${grouped(MAX_TEXT)} characters`;
      const start = text.slice(0, WINDOW);
      throw new LabyrinthSyntaxError(
        start, 0, "the text is too long", expected, grouped(text.length),
      );
    }
    this.original = normalised(text);
    this.position = 0;
    this.kept = []; // The offsets of the parts between comments, in `text` and in `original`.
    this.text = this.withoutComments();
  }

  withoutComments() {
    const { original } = this;
    let text = "";
    let position = 0;
    for (;;) {
      const opening = original.indexOf(QUOTES, position);
      this.kept.push([text.length, position]);
      text += original.slice(position, opening < 0 ? original.length : opening);
      if (opening < 0) return text;
      const closing = original.indexOf(QUOTES, opening + 3);
      if (closing < 0) {
        const expected = 'another """ after this one';
        throw new LabyrinthSyntaxError(
          original, opening, "a comment is not closed", expected, "the end of the text",
        );
      }
      const breaks = original.slice(opening, closing).replace(/[^\n]+/g, "");
      if (breaks) this.kept.push([text.length, opening]);
      text += breaks;
      position = closing + 3;
    }
  }

  /** Return offset and text of the next line that is not blank; at the end the text is empty. */
  nextLine() {
    const { text } = this;
    let begin = this.position;
    while (begin < text.length) {
      let end = text.indexOf("\n", begin);
      if (end < 0) end = text.length;
      const line = trimEnd(text.slice(begin, end));
      if (line) {
        this.position = end + 1;
        return [begin, line];
      }
      begin = end + 1;
    }
    return [text.length, ""];
  }

  originalOffset(offset) {
    if (offset >= this.text.length) return this.original.length;
    let shift = 0;
    for (const [kept, original] of this.kept) {
      if (kept > offset) break;
      shift = original - kept;
    }
    return offset + shift;
  }

  lineNumber(offset) {
    return this.original.slice(0, this.originalOffset(offset)).split("\n").length;
  }

  /** Throw the error for a mistake, or for a control character in its line, the likelier cause. */
  fail(offset, message, expected = null, found = null) {
    const end = this.text.indexOf("\n", offset);
    const begin = lineStart(this.text, offset);
    const line = this.text.slice(begin, end < 0 ? this.text.length : end);
    let at = 0;
    for (const char of line) {
      if (!isPrintable(char)) {
        throw this.error(
          begin + at,
          "tabs and other control characters may stand in comments only",
          "blanks or printable characters",
          describe(line, at),
        );
      }
      at += char.length;
    }
    throw this.error(offset, message, expected, found);
  }

  error(offset, message, expected = null, found = null) {
    const stands = expected !== null && found === null ? describe(this.text, offset) : found;
    const original = this.originalOffset(offset);
    return new LabyrinthSyntaxError(this.original, original, message, expected, stands);
  }
}

const normalised = (text) => text.replace(/^\ufeff/, "").replace(/\r\n?/g, "\n");

/** Return the text of a file, given as bytes. */
function decode(bytes) {
  if (bytes.length > MAX_TEXT) {
    const start = new TextDecoder().decode(bytes.subarray(0, WINDOW));
    const expected = `at most ${grouped(MAX_TEXT)} bytes`;
    throw new LabyrinthSyntaxError(start, 0, "the file is too long", expected, "more");
  }
  const options = { fatal: true, ignoreBOM: true };
  try {
    return new TextDecoder("utf-8", options).decode(bytes);
  } catch {
    // The longest prefix that may still become UTF-8, without an unfinished character.
    const begin = (length) =>
      new TextDecoder("utf-8", options).decode(bytes.subarray(0, length), { stream: true });
    let [good, bad] = [0, bytes.length + 1];
    while (bad - good > 1) {
      const middle = (good + bad) >> 1;
      try {
        begin(middle);
        good = middle;
      } catch {
        bad = middle;
      }
    }
    const text = begin(good);
    const at = new TextEncoder().encode(text).length;
    const before = normalised(text);
    const rest = new TextDecoder().decode(bytes.subarray(at, at + WINDOW));
    const found = `the byte 0x${bytes[at].toString(16).padStart(2, "0")}`;
    throw new LabyrinthSyntaxError(
      before + rest, before.length, "the file is no text", "UTF-8", found,
    );
  }
}

/**
 * Return the labyrinth that a text describes; throw LabyrinthSyntaxError if it is none.
 *
 * Tiles that the text leaves out are not placed: `missingTiles` says which.
 */
function parse(text) {
  const source = new Source(text);
  const settings = parseSettings(source);
  const drawing = parseDrawing(source);
  for (const [message, expected] of [
    ["the drawing is complete", "end"],
    ["there is text after 'end'", ""],
  ]) {
    const [offset, line] = source.nextLine();
    const rest = trimStart(line);
    if (rest !== expected) {
      const wanted = expected ? `'${expected}'` : "nothing but comments";
      source.fail(offset + line.length - rest.length, message, wanted, quoted(rest));
    }
  }
  try {
    return build(source, drawing, settings);
  } catch (error) {
    if (!(error instanceof LabyrinthError)) throw error;
    const offset = error.cell === null ? settings.offset : drawing.offset(error.cell);
    throw source.error(offset, error.message);
  }
}

function parseSettings(source) {
  let switchedOn = null;
  let look = LOOKS[0];
  const seen = new Map();
  for (;;) {
    const [offset, line] = source.nextLine();
    const colon = line.indexOf(":");
    const before = colon < 0 ? line : line.slice(0, colon);
    const after = colon < 0 ? "" : line.slice(colon + 1);
    const name = trimBlanks(before);
    const value = trimBlanks(after);
    const place = offset + before.length - trimStart(before).length;
    if (name === HEADING && colon >= 0 && !value) {
      return { ...(switchedOn ?? { task: "navigation", offset: place }), look };
    }
    if (!NAMES.includes(name) || colon < 0) refuseSetting(source, offset, line);
    if (seen.has(name)) {
      const found = `${name} again, after line ${source.lineNumber(seen.get(name))}`;
      source.fail(place, "a setting is given twice", "each setting at most once", found);
    }
    seen.set(name, place);
    const at = offset + before.length + 1 + after.length - trimStart(after).length;
    if (!VALUES[name].test(value.toLowerCase())) {
      const found = value ? quoted(value) : "the end of the line";
      source.fail(at, `in the value of ${name}`, EXPECTED[name], found);
    }
    if (name === LOOK) {
      look = value.toLowerCase();
    } else if (value.toLowerCase() === "true") {
      if (switchedOn) {
        const found = `${name}, after line ${source.lineNumber(switchedOn.offset)}`;
        source.fail(place, "two tasks are switched on", "one task at most", found);
      }
      switchedOn = { task: SETTINGS[name], offset: place };
    }
  }
}

function refuseSetting(source, offset, line) {
  const word = trimBlanks(line).split(" ")[0].split(":")[0];
  let place = offset + line.length - trimStart(line).length;
  const names = [HEADING, ...NAMES];
  if (names.includes(word)) {
    const after = trimStart(line.slice(place - offset + word.length));
    if (after.startsWith(":")) {
      place = offset + line.length - trimStart(after.slice(1)).length;
      source.fail(place, "the drawing begins on a line of its own", "the end of the line");
    }
    source.fail(offset + line.length - after.length, `after ${word}`, "':'");
  }
  if (!line || "-|".includes(line[0])) {
    const found = quoted(trimBlanks(line));
    source.fail(place, "nothing announces the drawing", `'${HEADING}:'`, found);
  }
  const close = closestName([...word].slice(0, 40).join("").toLowerCase(), names);
  const hint = close ? ` (did you mean ${close}?)` : "";
  const expected = `${NAMES.join(", ")} or ${HEADING}${hint}`;
  source.fail(place, "unknown setting", expected, quoted(word || trimBlanks(line)));
}

/** Return the name that difflib.get_close_matches finds closest to a word, if any is close. */
function closestName(word, names) {
  const scored = names
    .map((name) => [(2 * matching(name, word)) / (name.length + word.length), name])
    .filter(([score]) => score >= 0.6)
    .sort(([a, first], [b, second]) => b - a || (first < second ? 1 : -1));
  return scored.length ? scored[0][1] : null;
}

/** Return the number of matching characters, as Ratcliff and Obershelp count them. */
function matching(a, b) {
  let [length, atA, atB] = [0, 0, 0];
  for (let i = 0; i < a.length; i++) {
    for (let j = 0; j < b.length; j++) {
      let same = 0;
      while (i + same < a.length && j + same < b.length && a[i + same] === b[j + same]) same++;
      if (same > length) [length, atA, atB] = [same, i, j];
    }
  }
  if (!length) return 0;
  const left = matching(a.slice(0, atA), b.slice(0, atB));
  return left + length + matching(a.slice(atA + length), b.slice(atB + length));
}

function parseDrawing(source) {
  const top = parseTop(source);
  const width = (top.length - 1) / 4;
  const rows = [];
  const cellLines = [];
  const wallLines = [];
  let offset;
  let line;
  for (;;) {
    [offset, line] = source.nextLine();
    checkLine(source, offset, line, top.length, true);
    rows.unshift(offset);
    cellLines.unshift(line);
    [offset, line] = source.nextLine();
    if (line === top) break;
    checkLine(source, offset, line, top.length, false);
    if (rows.length === MAX_SIDE) {
      const expected = `at most ${grouped(MAX_SIDE)} rows`;
      source.fail(offset, "the drawing is too high", expected, "more");
    }
    wallLines.unshift(line);
  }
  const height = rows.length;
  if (height < MIN_SIDE) {
    const expected = `${MIN_SIDE} to ${grouped(MAX_SIDE)} rows`;
    source.fail(offset, "the drawing is too low", expected, String(height));
  }
  const up = new Uint8Array(height * width);
  const right = new Uint8Array(height * width);
  const tiles = [];
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) {
      const cell = row * width + column;
      tiles.push(cellLines[row][4 * column + 2]);
      right[cell] = cellLines[row][4 * column + 4] === " " ? 1 : 0;
      up[cell] = row + 1 < height && wallLines[row][4 * column + 2] === " " ? 1 : 0;
    }
  }
  const place = (cell) => rows[Math.floor(cell / width)] + 4 * (cell % width) + 2;
  return { height, width, up, right, tiles, offset: place };
}

function parseTop(source) {
  const [offset, line] = source.nextLine();
  const dashes = line.length - line.replace(/^-+/, "").length;
  if (!line || dashes < line.length) {
    const expected = dashes ? "'-'" : "a line of dashes, the outer wall";
    source.fail(offset + dashes, "in the top line of the drawing", expected);
  }
  const width = (dashes - 1) / 4;
  if (!Number.isInteger(width) || width < MIN_SIDE || width > MAX_SIDE) {
    const columns = `${MIN_SIDE} to ${grouped(MAX_SIDE)} columns`;
    source.fail(
      offset,
      "the top line of the drawing has the wrong length",
      `four dashes for each of ${columns}, and one more`,
      `${grouped(dashes)} dashes`,
    );
  }
  return line;
}

/** Return the characters allowed in a column of a line inside a drawing, and their description. */
function allowedAt(column, length, cells) {
  if (column === 0) return ["|", begins(length, cells)];
  if (column === length - 1) return ["|", "'|', the outer wall"];
  if (column % 2) return [" ", "a blank"];
  if (column % 4 === 0) return cells ? ["| ", "'|' or a blank"] : ["+", "'+'"];
  return cells ? [" SEKDI", "S, E, K, D, I or a blank"] : ["- ", "'-' or a blank"];
}

const begins = (length, cells) =>
  cells ? "'|', the outer wall" : `'|', or ${grouped(length)} dashes to end the drawing`;

function checkLine(source, offset, line, length, cells) {
  const kind = cells ? "cells" : "walls";
  if (/^-*$/.test(line)) {
    if (line && cells) {
      source.fail(offset, "a row is missing", "a line of cells", "an outer wall");
    }
    if (line) {
      const found = `${grouped(line.length)} dashes`;
      const expected = `${grouped(length)} dashes`;
      source.fail(offset, "in the bottom line of the drawing", expected, found);
    }
    source.fail(offset, "the drawing is not complete", begins(length, cells));
  }
  for (let column = 0; column < length; column++) {
    const [allowed, expected] = allowedAt(column, length, cells);
    const char = line[column];
    if (char === undefined || !allowed.includes(char)) {
      const found = char === undefined ? "the end of the line" : null;
      source.fail(offset + column, `in a line of ${kind}`, expected, found);
    }
  }
  if (line.length > length) {
    const further = offset + line.length - trimStart(line.slice(length)).length;
    source.fail(further, `in a line of ${kind}`, "the end of the line");
  }
}

function build(source, drawing, { task, look }) {
  const { height, width, up, right, tiles } = drawing;
  const labyrinth = {
    height, width, up, right, task, look,
    start: only(source, drawing, "S") ?? 0,
    goal: only(source, drawing, "E") ?? height * width - 1,
    key: null, door: null, ice: [],
  };
  if (task === "key_and_door") {
    labyrinth.key = only(source, drawing, "K");
    labyrinth.door = only(source, drawing, "D");
  } else if (task === "icy_floor") {
    labyrinth.ice = [...tiles.keys()].filter((cell) => tiles[cell] === "I");
  }
  return checked(labyrinth);
}

function only(source, drawing, tile) {
  const cells = [...drawing.tiles.keys()].filter((cell) => drawing.tiles[cell] === tile);
  if (cells.length < 2) return cells.length ? cells[0] : null;
  const drawn = cells.map(drawing.offset).sort((a, b) => a - b);
  const found = `another, after line ${source.lineNumber(drawn[0])}`;
  return source.fail(drawn[1], `${tile} is drawn twice`, `one ${tile} at most`, found);
}

/** Return the text of a drawing, even of one that breaks a rule. */
function dump(labyrinth) {
  const { height, width, up, right, task, look } = labyrinth;
  const tiles = new Map(labyrinth.ice.map((cell) => [cell, "I"]));
  if (labyrinth.key !== null) tiles.set(labyrinth.key, "K");
  if (labyrinth.door !== null) tiles.set(labyrinth.door, "D");
  tiles.set(labyrinth.start, "S");
  tiles.set(labyrinth.goal, "E");
  const columns = Array.from({ length: width }, (_, column) => column);
  const outerWall = "-".repeat(4 * width + 1);
  const lines = [outerWall];
  for (let row = height - 1; row >= 0; row--) {
    if (row < height - 1) {
      const walls = columns.map((column) => (up[row * width + column] ? " " : "-"));
      lines.push(`| ${walls.join(" + ")} |`);
    }
    const cells = columns.map((column) => {
      const cell = row * width + column;
      return ` ${tiles.get(cell) ?? " "} ${right[cell] ? " " : "|"}`;
    });
    lines.push(`|${cells.join("")}`);
  }
  const settings = Object.entries(SETTINGS).map(
    ([name, switchedOn]) => `${name}: ${switchedOn === task ? "True" : "False"}\n`,
  );
  if ((look ?? LOOKS[0]) !== LOOKS[0]) settings.push(`${LOOK}: ${look}\n`);
  return `${settings.join("")}\n${HEADING}:\n${lines.join("\n")}\n${outerWall}\nend\n`;
}
