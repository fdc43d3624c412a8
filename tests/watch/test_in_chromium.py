"""The page in a headless Chromium: sliders change the run, the picture moves, nothing complains, nothing is loaded."""

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("nicegui", reason="needs tsjepa[watch]")
pytest.importorskip("selenium", reason="needs selenium, of tsjepa[test]")

from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

BROWSER, DRIVER = shutil.which("chromium") or shutil.which("google-chrome"), shutil.which("chromedriver")
RECIPE = Path(__file__).parents[2] / "recipes" / "watch.yaml"
PATIENCE = 300  # seconds: of a machine that has much else to do
OPTIONS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--window-size=1600,900"]
OPTIONS += [
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
]
PICTURE = "return performance.getEntriesByType('resource').filter(e => e.name.includes('fleet.jpg')).length"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (BROWSER and DRIVER), reason="Chromium and chromedriver are not installed"),
]


@pytest.fixture(scope="module")
def address():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-m", "tsjepa.cli", "watch", "--config", str(RECIPE), "--port", str(port)]
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST", "NICEGUI"))}
    server = subprocess.Popen(command, env=environment)
    deadline = time.monotonic() + PATIENCE
    while not answers(port):
        assert server.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.5)
    yield f"http://127.0.0.1:{port}"
    server.send_signal(signal.SIGINT)
    assert server.wait(PATIENCE) in (0, 130)  # Ctrl-C ends it, and the fleet with it


@pytest.fixture(scope="module")
def browser(address, tmp_path_factory):
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for option in [*OPTIONS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"]:
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options, webdriver.ChromeService(DRIVER))
    driver.set_page_load_timeout(PATIENCE)
    driver.get(address)
    wait(driver, lambda _: number(driver, "slot"))
    yield driver
    driver.quit()


def answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def wait(driver, condition):
    return WebDriverWait(driver, PATIENCE).until(condition)


def number(driver, name: str) -> float | None:
    """A number that the page shows, None until it does."""
    found = driver.find_elements(By.ID, "numbers")
    match = re.search(rf"^{name} +([\d.]+)", found[0].text, flags=re.MULTILINE) if found else None
    return float(match[1]) if match else None


def press(driver, slider: str, *keys: str) -> None:
    driver.find_element(By.CSS_SELECTOR, f"[aria-label='{slider}'] [tabindex='0']").send_keys(*keys)


def shown(driver) -> bytes:
    return driver.find_element(By.ID, "fleet").screenshot_as_png


def test_the_picture_moves(browser):
    first, slot, loaded = shown(browser), number(browser, "slot"), browser.execute_script(PICTURE)
    wait(browser, lambda _: number(browser, "slot") > slot)
    wait(browser, lambda _: browser.execute_script(PICTURE) > loaded + 3)
    wait(browser, lambda _: shown(browser) != first)
    image = browser.find_element(By.CSS_SELECTOR, "#fleet img")
    wait(browser, lambda _: image.get_property("naturalWidth") > 1000)  # 0 while the next one is being loaded


def test_sliders_change_the_run(browser):
    assert number(browser, "devices") == 24
    press(browser, "devices", *[Keys.ARROW_LEFT] * 4)
    wait(browser, lambda _: number(browser, "devices") == 20)
    assert number(browser, "mean age") < 10
    press(browser, "loss", Keys.PAGE_UP, Keys.PAGE_UP)
    wait(browser, lambda _: number(browser, "mean age") > 10)
    press(browser, "loss", Keys.PAGE_DOWN, Keys.PAGE_DOWN)
    wait(browser, lambda _: number(browser, "mean age") < 10)


def test_a_scheduler_is_chosen(browser):
    browser.find_element(By.XPATH, "//label[contains(., 'scheduler')]").click()
    wait(browser, lambda _: browser.find_elements(By.XPATH, "//div[@role='option'][contains(., 'none')]"))
    browser.find_element(By.XPATH, "//div[@role='option'][.='none']").click()
    wait(browser, lambda _: number(browser, "updates") == 0)


def test_a_cart_is_pushed_by_the_button_and_by_a_click_on_its_tile(browser):
    browser.find_element(By.XPATH, "//button[contains(., 'Push a cart')]").click()
    wait(browser, lambda _: "Pushed device" in browser.page_source)
    browser.find_element(By.CSS_SELECTOR, "#fleet img").click()
    wait(browser, lambda _: len(re.findall(r"Pushed device \d+", browser.page_source)) > 1)


def test_the_console_is_clean_and_nothing_comes_from_elsewhere(browser, address):
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []
    names = browser.execute_script("return performance.getEntriesByType('resource').map(entry => entry.name)")
    assert names
    assert {name for name in names if not name.startswith((address, address.replace("http", "ws"), "data:"))} == set()
