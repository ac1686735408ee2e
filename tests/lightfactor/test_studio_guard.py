"""Who may ask the workbench's server: every route refuses all others, and changes nothing for them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from lightfactor.studio.opened import key_of, open_path

from .studios import Served, files_of

# Every route, with a photograph and a result that there are.
PHOTO = key_of("000.exr")
ROUTES = (
    ("GET", "/api/state"),
    ("POST", "/api/manifest"),
    ("GET", f"/api/photos/{PHOTO}/thumbnail"),
    ("GET", f"/api/photos/{PHOTO}"),
    ("POST", f"/api/photos/{PHOTO}/held-out"),
    ("GET", f"/api/photos/{PHOTO}/mask"),
    ("POST", f"/api/photos/{PHOTO}/mask"),
    ("GET", f"/api/photos/{PHOTO}/checks"),
    ("GET", "/api/surface"),
    ("GET", "/api/mesh"),
    ("GET", "/api/picks"),
    ("POST", "/api/picks"),
    ("POST", "/api/alignments"),
    ("POST", "/api/fits"),
    ("POST", "/api/fits/x/cancel"),
    ("GET", "/api/fits/x/progress"),
    ("GET", "/api/lightings/x/map"),
    ("POST", "/api/lightings/x/source-regions"),
    ("GET", "/api/results/x"),
    ("GET", "/api/results/x/lightings/x/map"),
    ("GET", "/api/results/x/plan"),
    ("POST", "/api/results/x/plans"),
    ("GET", f"/api/results/x/photos/{PHOTO}"),
    ("GET", f"/api/results/x/photos/{PHOTO}/terms/1/0/0"),
    ("GET", "/api/results/x/subject"),
    ("GET", "/api/results/x/lights/0"),
    ("GET", "/api/results/x/lights/0/error"),
    ("POST", "/api/results/x/still"),
    ("GET", "/api/results/x/page"),
    ("POST", "/api/lights?name=a.hdr"),
)


@pytest.mark.parametrize(
    ("status", "headers"),
    [
        (403, {"X-Lightfactor-Token": ""}),
        (403, {"X-Lightfactor-Token": "of another launch"}),
        (403, {"Origin": "https://elsewhere.example"}),
        (403, {"Origin": "http://127.0.0.1:1"}),
        (403, {"Origin": "null"}),
        (403, {"Sec-Fetch-Site": "cross-site"}),
        (421, {"Host": "elsewhere.example"}),
        (421, {"Host": "127.0.0.1.elsewhere.example"}),
        (421, {"Host": "elsewhere.example:80@127.0.0.1.example"}),
        (413, {"Content-Length": str(1 << 40)}),
    ],
    ids=lambda value: (
        None if isinstance(value, int) else " ".join(value.items().__iter__().__next__()).strip()
    ),
)
def test_what_comes_from_elsewhere_is_refused_by_every_route(
    bench: Served, ball: Path, status, headers
) -> None:
    # Those who may ask get through to each of them.
    from lightfactor.studio.app import workbench

    known = {re.sub(r"\{\w+\}", "x", route.path) for route in workbench(open_path(ball), "")._app.routes}
    asked = {re.sub(r"/\d\b", "/x", path.partition("?")[0].replace(PHOTO, "x")) for _, path in ROUTES}
    assert known == asked | {"/", "/page/x"}
    before = files_of(ball)
    for method, path in ROUTES:
        found, answered, body = bench.ask(method, path, headers)
        assert found == status, path
        assert answered["content-type"].startswith("text/plain")
        assert b"faulty" not in body
    assert files_of(ball) == before


def test_a_body_that_turns_out_longer_than_it_said_is_cut_off(bench: Served, ball: Path) -> None:
    before = files_of(ball)
    body = b'{"samples": ' + b" " * (2 << 20) + b"1000}"
    assert bench.ask("POST", "/api/fits", body=body)[0] == 413

    def pieces() -> Iterator[bytes]:
        for k in range(0, len(body), 1 << 16):
            yield body[k : k + (1 << 16)]

    # Without a length, in chunks.
    assert bench.ask("POST", "/api/fits", body=pieces())[0] == 413  # type: ignore[arg-type]
    assert files_of(ball) == before


@pytest.mark.parametrize(
    "path",
    [
        "/page/../app.py",
        "/page/..%2fapp.py",
        "/page/%2e%2e/%2e%2e/cli.py",
        "/page//etc/passwd",
        "/page/index.html.jinja",
        "/../photoset.toml",
        "/api/photos/..%2f..%2fphotoset.toml",
        "/api/photos/000.exr",
        "/api/results/..",
        f"/api/results/x/photos/{PHOTO}",
    ],
)
def test_nothing_is_read_by_its_path(bench: Served, path: str) -> None:
    status, _, body = bench.ask("GET", path)
    assert status in (404, 400)
    assert b"photo]" not in body
    assert b"import" not in body


def test_the_page_loads_nothing_from_elsewhere_and_can_not_be_framed(bench: Served) -> None:
    status, headers, body = bench.ask("GET", "/", {"X-Lightfactor-Token": ""})
    assert status == 200
    policy = headers["content-security-policy"]
    assert "default-src 'self'" in policy
    assert "frame-ancestors 'none'" in policy
    assert "unsafe" not in policy
    assert headers["x-content-type-options"] == "nosniff"
    assert not [name for name in headers if name.lower().startswith("access-control")]
    assert b"://" not in body
    scripts = re.findall(rb'(?:src|href)="(/page/[^"]+)"', body)
    assert len(scripts) == 3
    for script in scripts:
        status, headers, _ = bench.ask("GET", script.decode())
        assert status == 200
        assert headers["content-type"].split(";")[0] in ("text/javascript", "text/css")
    assert bench.ask("POST", "/", body=b"{}")[0] == 405
