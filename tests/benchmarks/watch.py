"""The page of ``tsjepa watch`` in a headless Chromium: how fast the fleet runs beside it, and a picture of it.

    python tests/benchmarks/watch.py        # a minute, on an idle machine; needs tsjepa[watch], selenium and Chromium

Fleet, page and browser share the machine. A pace of 1 is real time. Writes docs/results/watch.json and
docs/pictures/watch.png.
"""

import argparse
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from report import publish, spread
from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import WebDriverWait

ROOT = Path(__file__).parents[2]
OPTIONS = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--window-size=1600,800")
OPTIONS += ("--disable-background-networking", "--disable-component-update", "--disable-sync")


def paces(driver: webdriver.Chrome, seconds: int) -> list[float]:
    """The pace that the page shows, once a second."""
    found = []
    for _ in range(seconds):
        time.sleep(1)
        shown = driver.find_element(By.ID, "numbers").text
        found.append(float(re.search(r"^real time +([\d.]+)", shown, re.MULTILINE)[1]))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--num_devices", type=int, default=24)
    parser.add_argument("--port", type=int, default=5742)
    parser.add_argument("--picture", default="docs/pictures/watch.png")
    parser.add_argument("--output", default="docs/results/watch.json")
    options = parser.parse_args()
    command = [sys.executable, "-m", "tsjepa.cli", "watch", "--config", str(ROOT / "recipes" / "watch.yaml")]
    command += ["--num_devices", str(options.num_devices), "--port", str(options.port)]
    server = subprocess.Popen(command)
    chrome = webdriver.ChromeOptions()
    chrome.binary_location = shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as profile:
        for option in (*OPTIONS, f"--user-data-dir={profile}"):
            chrome.add_argument(option)
        driver = webdriver.Chrome(chrome, webdriver.ChromeService(shutil.which("chromedriver")))
        time.sleep(20)  # until the page is served
        driver.get(f"http://127.0.0.1:{options.port}")
        WebDriverWait(driver, 60).until(lambda _: "real time" in driver.find_element(By.ID, "numbers").text)
        time.sleep(5)  # the pace is that of the last two seconds
        found = paces(driver, options.seconds)
        driver.save_screenshot(options.picture)
        driver.quit()
    server.send_signal(signal.SIGINT)
    server.wait(60)
    publish(options.output, {"num_devices": options.num_devices, "pace": spread(found)})


if __name__ == "__main__":
    main()
