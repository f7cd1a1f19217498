"""Measure the size of the report on many labyrinths, and the time until it is usable.

    python scripts/benchmark_report.py            # 100,000 labyrinths of 5x5
    python scripts/benchmark_report.py --size 25 --labyrinths 20000

The times are measured by Chromium: from the start of the navigation to the first contentful paint,
and until the gallery shows labyrinths and responds; medians of several openings, each in a context
of its own.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

from measuring import parser_of, positive, run_command
from playwright.sync_api import Browser, sync_playwright

TIMES = """async () => {
  const paint = await new Promise((resolve) => {
    const painted = (list) =>
      list.getEntriesByName("first-contentful-paint").forEach((entry) => resolve(entry.startTime));
    new PerformanceObserver(painted).observe({ type: "paint", buffered: true });
  });
  const usable = performance.getEntriesByName("usable")[0].startTime;
  const id = window.labyrinths.BLOCKS.at(-1).hex("id", 0);
  const began = performance.now();
  const box = document.querySelector("input[name=id]");
  box.value = id;
  box.dispatchEvent(new Event("input", { bubbles: true }));
  return { paint, usable, found: performance.now() - began };
}"""


def opened(browser: Browser, path: Path) -> dict[str, Any]:
    """Return the times of one opening of a page, in milliseconds."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    tab = context.new_page()
    tab.goto(path.as_uri())
    times: dict[str, Any] = tab.evaluate(TIMES)
    context.close()
    return times


def main() -> None:
    """Make the page, open it, and print the measurements."""
    parser = parser_of(__doc__, rounds=5)
    parser.add_argument("--labyrinths", type=positive, default=100_000, help="in six splits")
    parser.add_argument("--size", default="5", help="rows and columns, as for run.py")
    options = parser.parse_args()
    labyrinths = 6_000 if options.quick else options.labyrinths
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        common = [f"size={options.size}", f"labyrinths={labyrinths // 6}", f"data_dir={folder}"]
        run_command(*common, "stages=[build,analyse]")
        cost = run_command(*common, "stages=[report]", f"run_dir={folder}/none")
        path = Path(folder, "report", "index.html")
        megabytes = path.stat().st_size / 1e6
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"))
        openings = [opened(browser, path) for _ in range(options.rounds)]
        print(f"{6 * (labyrinths // 6):,} labyrinths; Chromium {browser.version}")
        browser.close()
    paint, usable, found = (median(each[name] for each in openings) for name in openings[0])
    print(f"  the stage                {cost.seconds:8.1f} s")
    print(f"  index.html               {megabytes:8.1f} MB")
    print(f"  first contentful paint   {paint:8.0f} ms")
    print(f"  gallery usable           {usable:8.0f} ms")
    print(f"  one found by its id      {found:8.0f} ms")


if __name__ == "__main__":
    main()
