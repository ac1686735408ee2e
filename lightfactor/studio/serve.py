"""Serves the workbench on this machine until it is stopped."""

from __future__ import annotations

import secrets
import socket
from pathlib import Path

from capture.terminal import console
from lightfactor.studio.opened import open_path

HOST = "127.0.0.1"


def serve(path: Path, port: int | None, open_browser: bool) -> None:
    """Serve what a path names. port : None for any that is free; ValueError where it isn't."""
    opened = open_path(path)
    try:
        import uvicorn

        from lightfactor.studio.app import workbench
    except ImportError as error:
        raise ValueError(
            f"the workbench needs {error.name}: install it with `pip install 'lightfactor[studio]'`"
        ) from error
    # It puts handlers of signals in place when it is imported: before the server has its own.
    import pycolmap  # noqa: F401

    token = secrets.token_urlsafe(32)
    listening = _listening(port)
    port = listening.getsockname()[1]
    address = f"http://{HOST}:{port}/#{token}"
    console.print(f"Open in a browser: {address}", soft_wrap=True, markup=False)
    console.print(
        f"From another machine, first: ssh -L {port}:{HOST}:{port} THIS-MACHINE", soft_wrap=True, markup=False
    )
    console.print("Ctrl-C ends it; fits that run go on.", markup=False)
    if open_browser:
        import webbrowser

        webbrowser.open(address)
    server = uvicorn.Server(
        uvicorn.Config(
            workbench(opened, token),
            log_level="error",
            access_log=False,
            lifespan="off",
            server_header=False,
            timeout_graceful_shutdown=1,
        )
    )
    server.run(sockets=[listening])


def _listening(port: int | None) -> socket.socket:
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((HOST, port or 0))
    except OSError as error:
        listening.close()
        raise ValueError(
            f"--port {port}: {str(error.strerror).lower()}; give another, or leave --port out"
        ) from error
    return listening
