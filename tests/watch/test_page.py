"""The page as NiceGUI's own simulated user sees it; no browser is needed."""

import asyncio
import sys
from pathlib import Path

import pytest

pytest.importorskip("nicegui", reason="needs tsjepa[watch]")

import cv2
import numpy as np
from nicegui import ui
from nicegui.testing import user_simulation

from tsjepa.watch.tiles import Layout

APP = Path(__file__).with_name("page_app.py")


def simulated(steps) -> None:
    """Runs the coroutine function ``steps`` with a user whose page is open and shows the fleet."""

    async def session():
        async with user_simulation(main_file=APP) as user:
            await user.open("/")
            await picture(user)
            await user.should_see("mean age")
            await steps(user)

    asyncio.run(session())


async def picture(user) -> np.ndarray:
    """What the browser loads as the fleet's picture: after 0.1 s a new one, and the fleet has run on."""
    await asyncio.sleep(0.1)
    answer = await user.http_client.get("/fleet.jpg")
    assert answer.headers["content-type"] == "image/jpeg"
    return cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR)


def widget(user, kind, label: str):
    """The slider or the choice with this label."""
    parts = user.find(kind).elements
    (found,) = (part for part in parts if label in (part.props.get("aria-label"), part.props.get("label")))
    return found


def test_the_picture_moves():
    async def steps(user):
        first = await picture(user)
        assert (await picture(user) != first).any()

    simulated(steps)


def test_sliders_and_choices_change_the_run():
    async def steps(user):
        await user.should_see("devices       4")
        widget(user, ui.slider, "devices").value = 7
        widget(user, ui.slider, "loss").value = 0.95
        await picture(user)
        await user.should_see("devices       7")
        widget(user, ui.select, "payload").value = "fp16"
        widget(user, ui.select, "scheduler").value = "none"
        for _ in range(2):
            await picture(user)
        await user.should_see("updates       0.0 kbit/s")

    simulated(steps)


def test_a_button_and_a_click_on_a_tile_push_a_cart():
    async def steps(user):
        user.find("Push a cart").click()
        await user.should_see("Pushed device")
        for device in (2, 3):
            y, x = Layout(4, (64, 128), believes=False).corner(device)
            click = {"image_x": x + 5, "image_y": y + 30, "mouse_event_type": "click"}
            user.find(ui.interactive_image).trigger("mouse", click)
            await user.should_see(f"Pushed device {device}")
        await picture(user)

    simulated(steps)


def test_without_the_extra_the_command_says_what_to_install(capsys, monkeypatch):
    from tsjepa import cli

    monkeypatch.setitem(sys.modules, "nicegui", None)
    assert cli.main(["watch"]) == 1
    assert "pip install 'tsjepa[watch]'" in capsys.readouterr().err
