#!/usr/bin/env python3
"""Claim: `torchbrdf live` shows at least 15 frames a second of 128 x 128 on 2 cores while the light is dragged.

    python scripts/benchmarks/live.py [--cores 2] [--pixels 128] [--seconds 5] [--screenshot FILE]

Starts the command on the embedded library's photograph, opens its page in headless Chromium, and drags the result's
sphere in circles with the mouse, 125 moves a second. Server and browser share the cores. A frame is counted where its
pictures are on the page's canvases. The printed line has the frames a second of every drag after a warm-up, the median
time between frames and the time below which 90 % of them are.
"""

import argparse
import math
import os
import re
import shutil
import signal
import statistics
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

from torchbrdf.command_line import Parser, exit_status

FLAGS = ("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking")
MOVE_S = 0.008
WARM_UP_S = 1.0
WATCH = """() => {
  window.arrivals = [];
  const watch = new MutationObserver(() => window.arrivals.push(performance.now()));
  watch.observe(document.getElementById("frames"), { childList: true, characterData: true, subtree: true });
}"""


def dragged(tab: Any, seconds: float) -> list[float]:
    """The times at which frames were shown, in ms, during a drag of the first sphere."""
    box = tab.locator("canvas").first.bounding_box()
    x, y, radius = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2, 0.3 * box["width"]
    tab.mouse.move(x + radius, y)
    tab.mouse.down()
    tab.evaluate("() => { window.arrivals.length = 0; }")
    start = time.perf_counter()
    while (now := time.perf_counter() - start) < seconds:
        tab.mouse.move(x + radius * math.cos(2 * now), y + radius * math.sin(2 * now))
        time.sleep(MOVE_S)
    arrivals = tab.evaluate("() => window.arrivals")
    tab.mouse.up()
    return arrivals


def measure(url: str, options: argparse.Namespace) -> str:
    """The line to print."""
    from playwright.sync_api import sync_playwright

    browser_path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path, args=list(FLAGS))
        tab = browser.new_page(viewport={"width": 1064, "height": 900})
        tab.goto(url)
        tab.evaluate(WATCH)
        dragged(tab, WARM_UP_S)
        drags = [dragged(tab, options.seconds) for _ in range(options.drags)]
        if options.screenshot is not None:
            tab.screenshot(path=options.screenshot)
        pictures, version = tab.locator("canvas").count(), browser.version
        browser.close()
    rates = [len(arrivals) / options.seconds for arrivals in drags]
    between = [b - a for arrivals in drags for a, b in pairwise(arrivals)]
    if len(between) < 10:
        raise ValueError("hardly a frame came; look at the page with --screenshot")
    ninety = statistics.quantiles(between, n=10)[-1]
    return (
        f"{', '.join(f'{rate:.1f}' for rate in rates)} frames a second at {options.pixels} x {options.pixels}, "
        f"{pictures} pictures, {options.cores} cores; between frames {statistics.median(between):.0f} ms, "
        f"90 % at most {ninety:.0f} ms; headless Chromium {version}"
    )


def run(options: argparse.Namespace) -> int:
    """Measure and print one line; 1 where a drag has fewer than 15 frames a second."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: options.cores])
        options.cores = len(os.sched_getaffinity(0))
    command = [sys.executable, "-m", "torchbrdf.cli", "live", "--no-browser", "--pixels", str(options.pixels)]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None
        url = next((found[0] for line in server.stdout if (found := re.search(r"http://\S+", line))), None)
        if url is None:
            raise OSError("the command ended without a page")
        line = measure(url, options)
    finally:
        server.send_signal(signal.SIGINT)
        server.wait()
    print(line)
    return 0 if min(map(float, line.split(" frames")[0].split(", "))) >= 15 else 1


def main() -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--pixels", type=int, default=128)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--drags", type=int, default=3)
    parser.add_argument("--screenshot", type=Path)
    return exit_status("live", run, parser.parse_args())


if __name__ == "__main__":
    sys.exit(main())
