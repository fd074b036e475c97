"""Run a file of launch/ by name: `rfpp train …` is `python launch/train.py …`."""

from __future__ import annotations

import ast
import runpy
import sys

from rfpp.folders import carried

#: Folder with one file per command.
FOLDER = carried("launch", "_launch")


def main() -> int:
    """Run the command named on the command line; return the exit status if there is none."""
    files = {file.stem: file for file in sorted(FOLDER.glob("*.py"))}
    name = sys.argv[1] if len(sys.argv) > 1 else "--help"
    if name in ("-h", "--help"):
        print("usage: rfpp <command> [<setting>=<value> …]; every command takes --help\n")
        for command, file in files.items():
            about = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8")))
            print(f"  {command:<18} {about.splitlines()[0]}")
        return 0
    if name not in files:
        print(f"error: rfpp {name}: no such command: choose from {', '.join(files)}", file=sys.stderr)
        return 1
    sys.argv = [str(files[name]), *sys.argv[2:]]  # Lightning starts further processes by this path
    runpy.run_path(str(files[name]), run_name="__main__")
    return 0


if __name__ == "__main__":
    sys.exit(main())
