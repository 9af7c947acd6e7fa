// Runs MicroPython under Node: micropython.mjs MODULE FOLDER < {"code": ..., "data": ...}
// The files of the folder are the board's. Prints what the code prints.
import fs from "node:fs";
import path from "node:path";
import { pathToFileURL } from "node:url";

const [module, folder] = process.argv.slice(2);
const { code, data } = JSON.parse(fs.readFileSync(0, "utf8"));
const { loadMicroPython } = await import(pathToFileURL(module));
const board = await loadMicroPython({
  heapsize: 8 * 1024 * 1024,
  linebuffer: true,
  stdout: (text) => process.stdout.write(text + "\n"),
});

function copy(from, to) {
  for (const entry of fs.readdirSync(from, { withFileTypes: true })) {
    const [source, target] = [path.join(from, entry.name), `${to}/${entry.name}`];
    if (entry.isDirectory()) {
      board.FS.mkdir(target);
      copy(source, target);
    } else {
      board.FS.writeFile(target, fs.readFileSync(source));
    }
  }
}

copy(folder, "");
board.FS.writeFile("/data.json", data);
try {
  board.runPython("import sys\nsys.path.insert(0, '/')\n" + code);
} catch (error) {
  console.error(String(error));
  process.exit(1);
}
