"""Frames as a video: MP4, in a format that this OpenCV can encode."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

# VP9, which browsers play, or else MPEG-4.
_CODECS = ("vp09", "mp4v")


def write_video(path: Path, frames: Iterable[NDArray[np.uint8]], fps: float) -> None:
    """Write sRGB frames (h, w, 3) as .mp4; of odd sides the last row or column is doubled, as the formats need it.

    Raises ValueError where OpenCV has no encoder for it.
    """
    writer: cv2.VideoWriter | None = None
    try:
        for frame in frames:
            height, width = frame.shape[:2]
            even = np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
            writer = writer or _writer(path, (even.shape[1], even.shape[0]), fps)
            writer.write(np.ascontiguousarray(even[:, :, ::-1]))
    finally:
        if writer is not None:
            writer.release()


def _writer(path: Path, size: tuple[int, int], fps: float) -> cv2.VideoWriter:
    for codec in _CODECS:
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), fps, size)
        if writer.isOpened():
            return writer
    raise ValueError(
        f"{path.name}: the installed OpenCV cannot encode MP4 ({', '.join(_CODECS)}); give a folder's name, and the"
        " pictures are written there"
    )
