"""The workbench's routes: what the page asks for, and what is done about it."""

from __future__ import annotations

import asyncio
import json
import tempfile
from collections.abc import AsyncIterator, Callable
from functools import cache, partial
from importlib.resources import files
from pathlib import Path
from typing import Any

from markupsafe import Markup
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp

from invrender.output.export.html import export_page
from invrender.output.live.bundle import page_files as live_files
from invrender.output.pages import page_template
from lightfactor.studio import described, jobs, masking, picking, placed, regions, starter
from lightfactor.studio.guard import Guard
from lightfactor.studio.manifest import write_key
from lightfactor.studio.opened import Opened, UnknownIdError
from lightfactor.studio.pictures import judged, shown_photo, thumbnail
from lightfactor.studio.relit import Relit, keep_map, maps

_PAGE = files("lightfactor.studio") / "page"
_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css"}
_PACKED, _JPEG, _PNG = "application/octet-stream", "image/jpeg", "image/png"
# Seconds between looks at a fit's progress.
_LOOK = 0.3
# Pixels of a photograph to a side of a predicted one.
_MOST_BINNED = 100

# A request's parameters, and the object of its body, to an answer.
_Handler = Callable[[dict[str, str], dict[str, Any]], Response]


def workbench(opened: Opened, token: str) -> ASGIApp:
    """The application that serves what is open to who has the token."""
    api: list[tuple[str, str, _Handler]] = [
        ("GET", "/api/state", partial(_state, opened)),
        ("POST", "/api/manifest", partial(_write_manifest, opened)),
        ("GET", "/api/photos/{photo}/thumbnail", partial(_thumbnail, opened)),
        ("GET", "/api/photos/{photo}", partial(_photo, opened)),
        ("POST", "/api/fits", partial(_start, opened)),
        ("POST", "/api/fits/{fit}/cancel", partial(_cancel, opened)),
        ("GET", "/api/mesh", partial(_mesh, opened)),
        ("GET", "/api/picks", partial(_picks, opened)),
        ("POST", "/api/picks", partial(_save_picks, opened)),
        ("POST", "/api/alignments", partial(_align, opened)),
        ("POST", "/api/photos/{photo}/held-out", partial(_hold_out, opened)),
        ("GET", "/api/photos/{photo}/mask", partial(_mask, opened)),
        ("GET", "/api/photos/{photo}/checks", partial(_checks, opened)),
        ("GET", "/api/surface", partial(_surface, opened)),
        ("GET", "/api/lightings/{lighting}/map", partial(_light_seen, opened)),
        ("POST", "/api/lightings/{lighting}/source-regions", partial(_save_regions, opened)),
        ("GET", "/api/results/{result}", partial(_result, opened)),
        ("GET", "/api/results/{result}/lightings/{lighting}/map", partial(_light_seen, opened)),
        ("GET", "/api/results/{result}/plan", partial(_plan, opened)),
        ("POST", "/api/results/{result}/plans", partial(_start_plan, opened)),
        ("GET", "/api/results/{result}/photos/{photo}", partial(_judged, opened)),
        (
            "GET",
            "/api/results/{result}/photos/{photo}/terms/{factor}/{row}/{column}",
            partial(_terms, opened),
        ),
        ("GET", "/api/results/{result}/subject", partial(_subject, opened)),
        ("GET", "/api/results/{result}/lights/{number}", partial(_light, opened)),
        ("GET", "/api/results/{result}/lights/{number}/error", partial(_error, opened)),
        ("POST", "/api/results/{result}/still", partial(_still, opened)),
        ("GET", "/api/results/{result}/page", partial(_exported, opened)),
    ]
    routes = [Route(path, _answering(handler), methods=[method]) for method, path, handler in api]
    routes += [
        Route("/api/fits/{fit}/progress", partial(_progress, opened), methods=["GET"]),
        Route("/api/lights", _taking(partial(_keep_map, opened)), methods=["POST"]),
        Route("/api/photos/{photo}/mask", _taking(partial(_keep_mask, opened)), methods=["POST"]),
        Route("/", _page, methods=["GET"]),
        Route("/page/{name}", _page, methods=["GET"]),
    ]
    return Guard(Starlette(routes=routes), token)


def _answering(handler: _Handler) -> Callable[[Request], Any]:
    """An endpoint that runs a handler beside others, and says what is wrong in a sentence."""

    async def endpoint(request: Request) -> Response:
        body = await request.body() if request.method == "POST" else b""
        try:
            return await run_in_threadpool(handler, dict(request.path_params), _object(body))
        except (ValueError, OSError, KeyError, TypeError) as error:
            return _refused(error)

    return endpoint


def _object(body: bytes) -> dict[str, Any]:
    if not body:
        return {}
    try:
        found = json.loads(body)
    except ValueError as error:
        raise ValueError(f"the request is no JSON: {error}") from error
    if not isinstance(found, dict):
        raise ValueError("the request is no JSON object")
    return found


def _refused(error: Exception) -> Response:
    said = f"the request lacks {error}" if isinstance(error, KeyError) else str(error)
    return JSONResponse({"error": said}, 404 if isinstance(error, UnknownIdError) else 400)


@cache
def _pages() -> dict[str, str]:
    """The texts of the page's files, by name; nothing else is served."""
    own = {each.name: each.read_text(encoding="utf-8") for each in _PAGE.iterdir() if each.is_file()}
    form = page_template("invrender.output.live", "page/controls.html.jinja")
    controls = Markup(form.render(lights=[], has_gaps=True))
    index = page_template("lightfactor.studio", "page/index.html.jinja").render(controls=controls)
    found = live_files() | own | {"index.html": index}
    return {name: text for name, text in found.items() if Path(name).suffix in _TYPES}


async def _page(request: Request) -> Response:
    name = request.path_params.get("name", "index.html")
    if name not in _pages():
        return Response("there is no such page\n", 404, media_type="text/plain")
    return Response(_pages()[name], media_type=_TYPES[Path(name).suffix])


def _state(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    return JSONResponse(described.state(opened))


def _write_manifest(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    starter.write_manifest(opened.folder, body)
    return JSONResponse({})


def _exported(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    with tempfile.TemporaryDirectory() as folder:
        page = export_page(opened.result(of["result"]), Path(folder) / "page", photoset=opened.manifest)
        return Response(page.files[0].read_text(encoding="utf-8"), media_type="text/plain")


def _thumbnail(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    photoset, photo = opened.photo(of["photo"])
    return Response(thumbnail(photoset, photo, opened.own / "thumbnails"), media_type=_JPEG)


def _photo(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    return Response(shown_photo(*opened.photo(of["photo"])), media_type=_PACKED)


def _start(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    samples = body.get("samples")
    if samples is not None and not (isinstance(samples, int) and samples >= 1000):
        raise ValueError(f"samples is {samples}; give a number of 1000 or more")
    return _started(jobs.start_fit(opened, samples))


def _started(job: jobs.Job) -> Response:
    return JSONResponse({"id": job.key, "name": job.name})


def _cancel(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    jobs.cancel(jobs.job(opened, of["fit"]))
    return JSONResponse({})


async def _progress(opened: Opened, request: Request) -> Response:
    """Lines of JSON as a fit goes on, until it has ended."""
    try:
        job = await run_in_threadpool(jobs.job, opened, request.path_params["fit"])
    except ValueError as error:
        return _refused(error)

    async def lines() -> AsyncIterator[str]:
        last = ""
        while True:
            now = await run_in_threadpool(described.job, opened, job)
            if (line := json.dumps(now)) != last:
                yield line + "\n"
                last = line
            if now["state"] != "running":
                return
            await asyncio.sleep(_LOOK)

    return StreamingResponse(lines(), media_type="application/x-ndjson")


def _mesh(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    return Response(picking.mesh_to_pick(opened), media_type=_PACKED)


def _picks(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    return JSONResponse(picking.read_saved(opened))


def _save_picks(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    return JSONResponse(picking.save(opened, body["picks"]))


def _align(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    return _started(jobs.start_alignment(opened, opened.folder / picking.PICKS_NAME))


def _hold_out(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    if not isinstance(body["heldOut"], bool):
        raise ValueError(f"heldOut is {body['heldOut']!r}; it is true or false")
    photoset, photo = opened.photo(of["photo"])
    number = [each.name for each in photoset.photos].index(photo.name)
    write_key(photoset.manifest, "photo", number, "held_out", True if body["heldOut"] else None)
    return JSONResponse({})


def _mask(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    return Response(masking.mask_picture(opened.photo(of["photo"])[1]), media_type=_PNG)


def _checks(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    return Response(placed.checks(opened, opened.photo(of["photo"])[1]), media_type=_PACKED)


def _surface(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    return Response(placed.surface(opened), media_type=_PACKED)


def _light_seen(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    result = opened.result(of["result"]) if "result" in of else None
    return Response(regions.light_seen(opened, of["lighting"], result), media_type=_PACKED)


def _save_regions(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    regions.save_regions(opened, of["lighting"], body["regions"])
    return JSONResponse({})


def _plan(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    return JSONResponse({"plan": described.plan(opened, opened.result(of["result"]))})


def _start_plan(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    return _started(jobs.start_plan(opened, opened.result(of["result"]).folder))


def _result(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    return JSONResponse(described.result(opened, opened.result(of["result"])))


def _judged(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    found = judged(opened.result(of["result"]), _relit(opened, of).body, *opened.photo(of["photo"]))
    return Response(found, media_type=_PACKED)


def _terms(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    """What adds up to a pixel of a predicted photograph, of which one is `factor` by `factor` of the camera's."""
    factor, row, column = (int(of[name]) for name in ("factor", "row", "column"))
    if not 1 <= factor <= _MOST_BINNED:
        raise ValueError(f"factor is {factor}; it must be 1 to {_MOST_BINNED}")
    _, photo = opened.photo(of["photo"])
    return JSONResponse(_relit(opened, of).terms(photo.lighting, photo.camera.binned(factor), row, column))


def _relit(opened: Opened, of: dict[str, str]) -> Relit:
    return Relit(opened.result(of["result"]), opened.manifest, maps(opened.own))


def _subject(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    return Response(_relit(opened, of).subject(), media_type=_PACKED)


def _light(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    return Response(_relit(opened, of).light(int(of["number"])), media_type=_PACKED)


def _error(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    return JSONResponse({"stated": _relit(opened, of).stated(int(of["number"]))})


def _still(opened: Opened, of: dict[str, str], body: dict[str, Any]) -> Response:
    size = int(body["width"]), int(body["height"])
    return Response(_relit(opened, of).still(body["state"], size), media_type=_PACKED)


def _taking(keep: Callable[[Request, bytes], dict[str, str]]) -> Callable[[Request], Any]:
    """An endpoint that keeps a picture, which is the request's body as it is."""

    async def endpoint(request: Request) -> Response:
        body = await request.body()
        try:
            return JSONResponse(await run_in_threadpool(keep, request, body))
        except (ValueError, OSError) as error:
            return _refused(error)

    return endpoint


def _keep_mask(opened: Opened, request: Request, body: bytes) -> dict[str, str]:
    return {"name": masking.save_mask(opened, request.path_params["photo"], body).name}


def _keep_map(opened: Opened, request: Request, body: bytes) -> dict[str, str]:
    keep_map(opened.own, request.query_params.get("name", ""), body)
    return {}
