"""The report page: a summary, alternative texts, and nothing wider than a telephone."""

import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "results" / "report.html"
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
WIDTH = """<body style="margin:0"><script>
const frame = document.createElement("iframe");
frame.style = "width:WIDTHpx;height:800px;border:0";
frame.onload = () => {
  const page = frame.contentDocument;
  document.title = JSON.stringify({scroll: page.documentElement.scrollWidth, client: page.documentElement.clientWidth,
                                   table: Math.max(...[...page.querySelectorAll(".wide")].map(e => e.scrollWidth)),
                                   size: getComputedStyle(page.body).fontSize});
  document.body.innerText = document.title;
};
frame.srcdoc = PAGE;
document.body.append(frame);
</script>"""


class Tags(HTMLParser):
    """Start tags with their attributes, in order, and which of them are open where each begins."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags, self.open = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs) -> None:
        self.tags.append((tag, dict(attrs), list(self.open)))
        if tag == "div":
            self.open.append(dict(attrs).get("class"))

    def handle_endtag(self, tag) -> None:
        if tag == "div":
            self.open.pop()


def test_it_begins_with_ten_lines_that_say_how_the_figures_came_out():
    text = PAGE.read_text()
    short = text[text.index("<h2>In short</h2>") : text.index("<h2>Verdicts</h2>")]
    lines = re.findall(r"<li>(.*?)</li>", short)
    assert len(lines) == 10
    assert all(re.search(r": (\d+ [\w ]+(, )?)+\.$", line) for line in lines)


def test_pictures_have_words_and_wide_tables_scroll_in_themselves():
    tags = Tags(PAGE.read_text()).tags
    pictures = [attributes for tag, attributes, _ in tags if tag == "img"]
    assert len(pictures) == 10
    assert all(len(attributes["alt"]) > 40 for attributes in pictures)
    assert all("wide" in inside for tag, _, inside in tags if tag == "table")
    assert any(tag == "meta" and attributes.get("content") == "width=device-width" for tag, attributes, _ in tags)


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")
@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_is_wider_than_the_screen(width, tmp_path):
    # headless Chromium has windows of at least 500 px, so that the page is put into a frame of the width
    page = json.dumps(PAGE.read_text()).replace("</", "<\\/")
    (tmp_path / "frame.html").write_text(WIDTH.replace("WIDTH", str(width)).replace("PAGE", page))
    words = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    words += ["--virtual-time-budget=20000", "--dump-dom", (tmp_path / "frame.html").as_uri()]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300)
    found = json.loads(re.search(r"<title>(\{.*?\})</title>", done.stdout)[1])
    assert max(found["scroll"], found["table"]) <= found["client"] <= width
    assert float(found["size"].removesuffix("px")) >= 16
