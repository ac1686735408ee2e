"""Binary glTF 2.0: JSON and the bytes that it points into, in one file."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

_FLOAT, _UNSIGNED = 5126, 5125
_VERTICES, _INDICES = 34962, 34963
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3"}


class GlbBuffer:
    """The binary part as it grows: buffer views and accessors of what was put into it."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add_bytes(self, data: bytes, **keys: Any) -> int:
        """Put bytes in; returns the number of their view."""
        self._bytes += b"\0" * (-len(self._bytes) % 4)
        self.views.append({"buffer": 0, "byteOffset": len(self._bytes), "byteLength": len(data), **keys})
        self._bytes += data
        return len(self.views) - 1

    def add_vertices(self, values: NDArray[np.floating]) -> int:
        """Put values (v, 2 or 3) of vertices in; returns the number of their accessor."""
        return self._add(np.asarray(values, "<f4"), _FLOAT, _VERTICES)

    def add_indices(self, faces: NDArray[np.integer]) -> int:
        """Put faces (f, 3) in; returns the number of their accessor."""
        return self._add(np.asarray(faces, "<u4").reshape(-1, 1), _UNSIGNED, _INDICES)

    def _add(self, values: NDArray[Any], component: int, target: int) -> int:
        view = self.add_bytes(values.tobytes(), target=target)
        self.accessors.append(
            {
                "bufferView": view,
                "componentType": component,
                "count": len(values),
                "type": _KINDS[values.shape[1]],
                "min": values.min(axis=0).tolist(),
                "max": values.max(axis=0).tolist(),
            }
        )
        return len(self.accessors) - 1

    def file(self, document: dict[str, Any]) -> bytes:
        """The whole file, with the rest of the document."""
        parts = {
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{"byteLength": len(self._bytes)}],
        }
        text = json.dumps({**document, **parts}, allow_nan=False, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        data = bytes(self._bytes) + b"\0" * (-len(self._bytes) % 4)
        chunks = (
            struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
        )
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
