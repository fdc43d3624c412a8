"""The README and the tutorials are plain English: short sentences, a low grade, and not many lines."""

import json
import re
from pathlib import Path

import pytest
import textstat
from pages import DOCS, ROOT, text_of

LINES, GRADE, WORDS = 150, 10, 18
TUTORIALS = sorted(path.relative_to(ROOT).as_posix() for path in (DOCS / "tutorials").glob("*.*"))


def sentences(page: str) -> str:
    """The prose of a page or a notebook: no code, no tables, no headings; what stands between backticks is one word."""
    text = text_of(page)
    if page.endswith(".ipynb"):
        cells = json.loads(text)["cells"]
        text = "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    text = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    lines = [line for line in text.splitlines() if not re.match(r"\s*\||    |#|!\[|\[!\[|\$\$|:", line)]
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", "\n".join(lines))
    return re.sub(r"[*_]", "", re.sub(r"`[^`]*`|\$[^$]*\$", "it", text))


def test_the_readme_is_short():
    assert len(text_of("README.md").splitlines()) <= LINES


@pytest.mark.parametrize("page", ["README.md", "docs/start.md", *TUTORIALS])
def test_a_newcomer_can_read_it(page):
    text = sentences(page)
    assert textstat.flesch_kincaid_grade(text) <= GRADE
    assert textstat.avg_sentence_length(text) <= WORDS


def test_a_text_that_nobody_could_read_would_be_found(tmp_path, monkeypatch):
    hard = "Notwithstanding considerable methodological heterogeneity, interdisciplinary investigations "
    hard += "characteristically substantiate multidimensional representational incompatibilities, " * 3
    (tmp_path / "hard.md").write_text(f"# Heading\n\n{hard}.\n\n```python\nx = 1\n```\n")
    monkeypatch.setattr("pages.ROOT", Path(tmp_path))
    assert textstat.flesch_kincaid_grade(sentences("hard.md")) > GRADE
    assert textstat.avg_sentence_length(sentences("hard.md")) > WORDS
