// Reads requests from standard input, one JSON value a line, and answers each with one line:
// {text, data}: parse the message `data` (hexadecimal) by the definition `text` (ros2msg), and serialize it again.
"use strict";

const { createRequire } = require("module");
const fromPackages = createRequire(`${process.argv[2]}/package.json`);
const { parse } = fromPackages("@foxglove/rosmsg");
const { MessageReader, MessageWriter } = fromPackages("@foxglove/rosmsg2-serialization");

const plain = (_, value) => {
  if (typeof value === "bigint") return Number(value);
  return ArrayBuffer.isView(value) ? Array.from(value, (each) => plain("", each)) : value;
};

require("readline").createInterface({ input: process.stdin }).on("line", (line) => {
  const { text, data } = JSON.parse(line);
  let answer;
  try {
    const definitions = parse(text, { ros2: true });
    const message = new MessageReader(definitions).readMessage(Buffer.from(data, "hex"));
    const again = new MessageWriter(definitions).writeMessage(message);
    answer = { message, data: Buffer.from(again).toString("hex") };
  } catch (error) {
    answer = { error: String(error) };
  }
  process.stdout.write(`${JSON.stringify(answer, plain)}\n`);
});
