"""The web page: sliders, what the fleet does in numbers, and its picture."""

from __future__ import annotations

import time
from collections.abc import Sequence

from fastapi import Response
from nicegui import app, ui

from tsjepa.evaluation.fleet_film import DELIVERED, FAILED, LOST
from tsjepa.watch.screen import Screen
from tsjepa.watch.setting import Snapshot

HOST = "127.0.0.1"
PICTURE = "/fleet.jpg"
INTERVAL_S = 0.1  # between two pictures
MOST_DEVICES = 48
LEGEND = (("delivered", DELIVERED), ("sent and lost", LOST), ("failed, starts anew after 2 s", FAILED))


def serve(screen: Screen, codecs: Sequence[str], schedulers: Sequence[str], port: int) -> None:
    """Serves the page on this machine until the process is interrupted.

    Args:
        screen: what is shown.
        codecs, schedulers: what can be chosen.
        port: of the loopback address.

    Raises:
        ValueError: what a scheduler of the user's own has done has ended the fleet.
    """
    drawn_at, refused = 0.0, None

    @app.get(PICTURE)
    async def picture() -> Response:
        """The newest picture; a new one is drawn when the last one is old, so that nobody watching costs nothing.

        It is drawn in the thread of the event loop, the program's first: an OpenGL context has to be freed where it was
        used.
        """
        nonlocal drawn_at, refused
        if time.monotonic() - drawn_at > 0.8 * INTERVAL_S:
            drawn_at = time.monotonic()
            try:
                screen.draw()
            except (EOFError, ConnectionResetError, BrokenPipeError):
                app.shutdown()
            except ValueError as error:
                refused = error
                app.shutdown()
        return Response(screen.jpeg, media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    def root() -> None:
        page(screen, codecs, schedulers)

    ui.run(root, host=HOST, port=port, title="tsjepa", reload=False, show=False, show_welcome_message=False)
    if refused is not None:
        raise refused


def page(screen: Screen, codecs: Sequence[str], schedulers: Sequence[str]) -> None:
    """What one browser shows."""
    setting = screen.setting
    with ui.row().classes("w-full no-wrap items-start"):
        with ui.column().classes("w-64 shrink-0"):
            ui.label("tsjepa watch").classes("text-xl")
            slider("devices", setting, "devices", 1, max(MOST_DEVICES, setting.devices), 1)
            slider("mean SNR [dB]", setting, "snr_db", -5, 30, 1)
            slider("loss", setting, "loss", 0, 0.95, 0.05)
            ui.select(list(schedulers), label="scheduler").bind_value(setting, "scheduler").classes("w-full")
            ui.select(list(codecs), label="payload").bind_value(setting, "codec").classes("w-full")
            ui.button("Push a cart", on_click=lambda: tell(screen.push_someone())).classes("w-full")
            ui.label("A click on a tile pushes that one.").classes("text-sm text-gray-600")
            numbers = ui.label().classes("text-sm whitespace-pre font-mono").props("id=numbers")
            complaint = ui.label().classes("text-sm text-red-700")
        with ui.column().classes("grow"):
            with ui.row().classes("text-sm"):
                for text, (blue, green, red) in LEGEND:
                    ui.label(f"■ {text}").style(f"color: rgb({red}, {green}, {blue})")
                ui.label("left: camera, right: what the controller believes, decoded")
            image = ui.interactive_image(PICTURE, on_mouse=lambda event: push_at(screen, event.image_x, event.image_y))
            image.classes("w-full").props("id=fleet")

    def refresh() -> None:
        image.set_source(f"{PICTURE}?{time.monotonic_ns()}")
        if screen.now is not None:
            numbers.set_text(described(screen.now))
            complaint.set_text(screen.now.complaint)

    ui.timer(INTERVAL_S, refresh)


def slider(text: str, setting: object, name: str, low: float, high: float, step: float) -> None:
    """A slider that sets the attribute ``name``, under its name and value."""
    label = ui.label().classes("text-sm -mb-3")
    label.bind_text_from(setting, name, lambda value: f"{text}: {value:g}")
    # integers stay integers: a number of devices is one
    whole = isinstance(getattr(setting, name), int)
    bar = ui.slider(min=low, max=high, step=step).props(f"aria-label='{text}'")
    bar.bind_value(setting, name, forward=round if whole else float)


def push_at(screen: Screen, x: float, y: float) -> None:
    """Pushes the device whose tile was clicked."""
    device = screen.device_at(x, y)
    if device is not None:
        screen.push(device)
        tell(device)


def tell(device: int) -> None:
    """Says that a device was pushed."""
    ui.notify(f"Pushed device {device}.")


def described(now: Snapshot) -> str:
    """The fleet in a few lines."""
    return "\n".join(
        (
            f"devices       {len(now.age)}",
            f"failed        {now.failed.sum()}",
            f"mean age      {now.age.mean():.1f} slots",
            f"mean score    {now.score.mean():.2f}",
            f"updates       {now.bit_rate / 1000:.1f} kbit/s",
            f"slot          {now.slot}",
            f"real time     {now.pace:.2f}",
        )
    )
