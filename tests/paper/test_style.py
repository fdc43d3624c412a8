"""The figures: a question above, titles and units, one colour for a method, and no legend over data."""

import re

import matplotlib
import pytest

from tsjepa.evaluation import pictures, style
from tsjepa.paper import FIGURES, module_of, plots, store
from tsjepa.paper.command import RESULTS

matplotlib.use("Agg")
PLAIN = r"\(.+\)$"  # an axis ends with its unit in brackets


@pytest.fixture
def drawn(monkeypatch):
    """The figures that are saved, with the question above each."""
    kept = []
    keep = lambda figure, path, question: kept.append((figure, question))  # noqa: E731
    monkeypatch.setattr(plots, "save", keep)
    monkeypatch.setattr(style, "save", keep)
    yield kept
    matplotlib.pyplot.close("all")


def check(figure, question: str) -> None:
    assert question.endswith("?")
    figure.suptitle(question)
    figure.canvas.draw()
    axes = [axis for axis in figure.axes if axis.get_label() != "<colorbar>"]
    for axis in axes:
        assert axis.has_data()
        assert len(axes) == 1 or axis.get_title(), "a panel without a title"
        assert axis.get_legend() is None, "a legend over data"
        for text, ticks in ((axis.get_xlabel(), axis.get_xticks()), (axis.get_ylabel(), axis.get_yticks())):
            assert not text or re.search(PLAIN, text), f"the axis {text!r} has no unit"
            # names on the ticks need no unit, and panels side by side share the label of the first
            assert text or not len(ticks) or named(axis) or axis is not axes[0], "an axis without a label"
    for legend in figure.legends:
        box = legend.get_window_extent()
        assert not any(box.overlaps(axis.get_window_extent()) for axis in axes)


def named(axis) -> bool:
    """Whether ticks are words."""
    return any(
        re.search("[a-zA-Z]{2}", label.get_text()) for label in [*axis.get_yticklabels(), *axis.get_xticklabels()]
    )


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_of_the_paper_is_told_by_itself(name, drawn, tmp_path):
    module_of(name).draw(store.read(RESULTS, name), tmp_path / "picture.png")
    ((figure, question),) = drawn
    check(figure, question)


def test_the_plots_of_an_evaluation_are_told_by_themselves(drawn, tmp_path):
    rows = [
        {"controller": name, "update_every": period, "score_by_slot": [0.2, 0.5, 0.9]}
        for name in ("expert, perfect feedback", "TS-JEPA", "TS-JEPA, hold", "expert, zero")
        for period in (1, 5, "once")
    ]
    pictures.loop_plot(rows, tmp_path / "score.png")
    pictures.horizon_plot(rows, [0.5, 0.8, 1.0], tmp_path / "horizon.png")
    assert len(drawn) == 2
    for figure, question in drawn:
        check(figure, question)


def test_a_method_has_one_colour_and_different_methods_differ():
    assert style.color_of("TS-JEPA, hold") == style.color_of("TS-JEPA") == style.color_of("TS-JEPA, 20 MHz")
    assert style.line_of("TS-JEPA, hold") != style.line_of("TS-JEPA")
    assert (
        len({style.color_of(name) for name in ("TS-JEPA", "supervised 2", "supervised 4", "autoencoder", "expert")})
        == 5
    )
    assert len(set(style.SCHEDULERS.values())) == len(style.SCHEDULERS)
    assert style.color_of("my_own") == style.color_of("my_own") in style.PALETTE
