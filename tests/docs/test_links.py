"""Every link, and every path between backticks, leads somewhere."""

import re
import subprocess
from pathlib import Path

import pytest
from pages import PAGES, ROOT, links, prose, text_of

# the top of what a path of the repository begins with
TOPS = ("tsjepa", "tests", "recipes", "docs", "checkpoints")


@pytest.fixture(scope="module")
def tracked() -> set[Path]:
    """Files under version control and the folders that hold them."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    files = {Path(line) for line in listed.splitlines()}
    return files | {folder for file in files for folder in file.parents}


def anchors(page: str) -> set[str]:
    """What a link may name behind #, as GitHub makes it of headings."""
    headings = re.findall(r"^#+ (.+)$", prose(page), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_to_files_and_headings_that_are_there(page, tracked):
    for link in links(page):
        if re.match(r"(https?|mailto):", link):
            assert re.fullmatch(r"https://[\w.-]+\.\w{2,}(/\S*)?|mailto:\S+@\S+", link), link
            continue
        target, _, anchor = link.partition("#")
        path = (ROOT / page).parent / target if target else ROOT / page
        assert path.exists(), f"{page} links to {link}"
        inside = path.resolve().relative_to(ROOT)
        assert inside in tracked, f"{page} links to {link}, which is not under version control"
        if anchor:
            assert anchor in anchors(inside.as_posix()), f"{page} links to {link}"


@pytest.mark.parametrize("page", PAGES)
def test_paths_between_backticks_are_in_the_repository(page, tracked):
    named = re.findall(rf"`((?:{'|'.join(TOPS)})/[\w./-]+)`", text_of(page))
    for path in named:
        assert Path(path) in tracked, f"{page} names {path}"
