"""The page of the playground in a real browser."""

import pytest

from cotlearn.play import write_page


@pytest.fixture(scope="session")
def playground(tmp_path_factory):
    """The page, as a file on the disk."""
    return write_page(tmp_path_factory.mktemp("play") / "playground.html")


@pytest.fixture
def opened(browser, playground):
    """Opens the page at a link; fails on an error in the console or a request to outside."""
    pages = []

    def open_page(link="", *, file=playground, **options):
        page = browser.new_page(reduced_motion="reduce", **options)
        page.problems = []
        page.on("pageerror", lambda error: page.problems.append(str(error)))
        page.on("console", lambda m: m.type == "error" and page.problems.append(m.text))
        inside = ("file:", "data:", "blob:")
        page.on("request", lambda r: r.url.startswith(inside) or page.problems.append(r.url))
        page.set_default_timeout(60_000)
        page.goto(f"{file.as_uri()}{link}")
        pages.append(page)
        return page

    yield open_page
    for page in pages:
        assert page.problems == []
        page.close()
