"""Boards in photographs: files in, detections out, and a plain word where a board isn't as it was said to be."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.boards.board import Board, Detection
from capture.boards.charuco import charuco_detection, find_markers, misplaced, search_picture
from capture.boards.checkergrid import find_grid
from capture.boards.chessboard import chessboard_detection, ends_inside, exceeds, find_chessboard

# Fewer corners than these leave a view's own pose hardly determined.
MIN_CORNERS = 8
# How far the markers' side may be from what was said: paper bleeds, and outlines are good to a pixel or so.
_MAX_MARKER_MISFIT = 0.08
# Small dictionaries begin the large ones of their kind, so that these find the markers of all.
_DICTIONARIES = ("DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL")
_APRILTAGS = "DICT_APRILTAG_36h11"


@dataclass(frozen=True)
class MarkerReport:
    """Markers in a photograph whose board wasn't found.

    dictionary, numbers : those that fit most of what was seen. misplaced : whether they contradict the board's layout.
    """

    dictionary: str
    numbers: tuple[int, ...]
    misplaced: bool = False


@dataclass(frozen=True, eq=False)
class BoardView:
    """What one photograph shows of the board.

    detection : None where the board wasn't found.
    grid : size of the chessboard that was seen, and whether it ends within the picture; on a charuco board only where
        no markers were.
    markers : where the board wasn't found, the markers that were seen.
    marker_share : for a charuco board that was found, its markers' side over its squares'; None if too small to
    measure.
    """

    name: str
    size: tuple[int, int]
    detection: Detection | None
    grid: tuple[int, int] | None = None
    grid_ends_inside: bool = False
    markers: MarkerReport | None = None
    marker_share: float | None = None


def detect_board(image: NDArray[np.generic], board: Board) -> Detection | None:
    """The corners of a board in one photograph; None where it isn't found, or is of another size.

    image : (h, w) or (h, w, 3) RGB; uint8 as it is, otherwise scaled so that the brightest pixels are white.
    Where only a part of a chessboard is seen, `Detection.located` is false: see there.
    """
    return board_view(image, board, "image").detection


def board_view(image: NDArray[np.generic], board: Board, name: str) -> BoardView:
    """What a photograph shows of a board, for a search over many photographs; image as for `detect_board`."""
    grey = _grey(image)
    size = (grey.shape[1], grey.shape[0])
    if board.kind == "charuco":
        found, share = charuco_detection(grey, board)
        detection = None if found is None else _enough(found)
        if detection is not None:
            return BoardView(name, size, detection, marker_share=share)
        markers = _marker_report(grey, board)
        grid = find_grid(search_picture(grey)) if markers is None else None
        return BoardView(name, size, None, None if grid is None else grid.size, markers=markers)
    grid = find_chessboard(grey, board)
    detection = (
        None if grid is None or exceeds(grid, board) else _enough(chessboard_detection(grey, grid, board))
    )
    markers = _marker_report(grey, board) if detection is None else None
    if grid is None:
        return BoardView(name, size, None, markers=markers)
    return BoardView(name, size, detection, grid.size, ends_inside(grid, size), markers)


def check_board(views: Sequence[BoardView], board: Board) -> None:
    """ValueError if the photographs show another board than was said: it names what was seen."""
    if board.kind == "charuco":
        _check_charuco(views, board)
        _check_marker_side(views, board)
        return
    _check_plain(views, board)
    sizes = [(max(view.grid), min(view.grid)) for view in views if view.grid is not None]
    said = (max(board.corner_counts), min(board.corner_counts))
    # A smaller grid is another board only where the picture would have shown more of it.
    other = [
        (max(view.grid), min(view.grid))
        for view in views
        if view.grid is not None
        and (view.grid_ends_inside or max(view.grid) > said[0] or min(view.grid) > said[1])
    ]
    other = [size for size in other if size != said]
    if not other:
        return
    size, _ = Counter(other).most_common(1)[0]
    count, whole = sizes.count(size), sizes.count(said)
    # One view may be misread, or its board half covered; several that agree are no accident.
    if count > whole and (count > 1 or len(sizes) == 1):
        squares = "; inner corners are counted, not squares" if size == (said[0] - 1, said[1] - 1) else ""
        raise ValueError(
            f"--board {board.spec}: {size[0]}x{size[1]} inner corners were seen in {count} of {len(views)} photos,"
            f" {said[0]}x{said[1]} in {whole}{squares}; say chessboard:{size[0]}x{size[1]}:SIDE if that is the board,"
            " or leave out photos of other boards"
        )


def view_of_file(path: Path, board: Board, name: str | None = None) -> BoardView:
    """What a photograph on disk shows of a board; name : for messages, the file's if not given."""
    from capture.files.imagefile import read_pixels
    from capture.files.imageheader import is_raw
    from capture.files.rawfile import read_raw

    image = read_raw(path).linear if is_raw(path) else read_pixels(path)
    return board_view(image, board, name or path.name)


def _enough(detection: Detection) -> Detection | None:
    """The detection if either half of its corners, every other one, gives a pose for the other half to be judged by."""
    if len(detection.cells) < MIN_CORNERS:
        return None
    half = detection.cells.sum(axis=1) % 2 == 0
    for cells in (detection.cells[half], detection.cells[~half]):
        if len(cells) < MIN_CORNERS // 2 or np.linalg.matrix_rank(cells - cells.mean(axis=0)) < 2:
            return None
    return detection


def _grey(image: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Grey levels to look for corners in: only where edges run matters, not how bright they are."""
    import cv2

    pixels = np.asarray(image)
    if pixels.ndim not in (2, 3) or (pixels.ndim == 3 and pixels.shape[2] != 3):
        raise ValueError(f"an image has shape {pixels.shape}; it must be (h, w) or (h, w, 3)")
    if pixels.dtype != np.uint8:
        values = np.nan_to_num(pixels.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
        white = float(np.percentile(values, 99.5))
        if not white > 0:
            return np.zeros(pixels.shape[:2], np.uint8)
        # The square root spreads dark tones as cameras' own files do.
        pixels = np.round(255 * np.sqrt(np.clip(values / white, 0, 1))).astype(np.uint8)
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY) if pixels.ndim == 3 else pixels, np.uint8)


def _marker_report(grey: NDArray[np.uint8], board: Board) -> MarkerReport | None:
    """The dictionary whose markers a photograph shows, and their numbers; the board's own if any of them is seen."""
    picture = search_picture(grey)
    own = board.dictionary
    names = [*_DICTIONARIES, _APRILTAGS] if own is None else [own, *_DICTIONARIES, _APRILTAGS]
    best: MarkerReport | None = None
    for name in names:
        markers = find_markers(picture, name)
        numbers = tuple(int(number) for number in np.unique(markers.numbers))
        # A few markers of a large dictionary may be chance readings of something else.
        if len(numbers) >= (2 if name == own else 4) and (best is None or len(numbers) > len(best.numbers)):
            ours = name == own and numbers[-1] < _marker_count(board)
            best = MarkerReport(name, numbers, misplaced=ours and misplaced(markers, board))
            if name == own and len(numbers) >= 4:
                break
    return best


def _marker_count(board: Board) -> int:
    return board.columns * board.rows // 2


def _check_charuco(views: Sequence[BoardView], board: Board) -> None:
    """ValueError if more photographs contradict the board than show it; markers cut off or covered don't."""
    found = sum(view.detection is not None for view in views)
    needed = _marker_count(board)
    contrary = [
        view.markers
        for view in views
        if view.markers is not None
        and (
            view.markers.dictionary != board.dictionary
            or view.markers.misplaced
            or view.markers.numbers[-1] >= needed
        )
    ]
    if len(contrary) > found:
        name, count = Counter(markers.dictionary for markers in contrary).most_common(1)[0]
        numbers = sorted({n for markers in contrary if markers.dictionary == name for n in markers.numbers})
        if name != board.dictionary:
            why = f"none of {board.dictionary}; name that dictionary if it is the board's"
        elif numbers[-1] >= needed:
            why = f"their numbers go up to {numbers[-1]}, where this board's end at {needed - 1}"
        else:
            why = f"not in the places of a board of {board.columns}x{board.rows} squares; are columns and rows swapped?"
        raise ValueError(
            f"--board {board.spec}: markers {numbers[0]} to {numbers[-1]} of {name} were seen in {count} of"
            f" {len(views)} photos, {why}"
        )
    grids = [(max(view.grid), min(view.grid)) for view in views if view.grid is not None]
    if len(grids) > max(found, 1):
        size, _ = Counter(grids).most_common(1)[0]
        raise ValueError(
            f"--board {board.spec}: a chessboard without readable markers was seen in {len(grids)} of {len(views)}"
            f" photos; say chessboard:{size[0]}x{size[1]}:SIDE if it has none"
        )


def _check_marker_side(views: Sequence[BoardView], board: Board) -> None:
    """ValueError if the markers aren't as large as was said."""
    shares = [view.marker_share for view in views if view.marker_share is not None]
    if not shares or board.marker is None:
        return
    seen, said = float(np.median(shares)), board.marker / board.square
    if abs(seen / said - 1) > _MAX_MARKER_MISFIT:
        raise ValueError(
            f"--board {board.spec}: markers are {seen:.2f} times as wide as squares in {len(shares)} photos, not"
            f" {said:.2f} times; measure both: with squares of {board.square:.4g} m it would be"
            f" charuco:{board.columns}x{board.rows}:{board.square:.4g}:{seen * board.square:.2g}:{board.dictionary}"
        )


def _check_plain(views: Sequence[BoardView], board: Board) -> None:
    """ValueError if more photographs show markers than the chessboard, which has none."""
    marked = [view.markers for view in views if view.markers is not None]
    if len(marked) > max(sum(view.detection is not None for view in views), 1):
        name, _ = Counter(markers.dictionary for markers in marked).most_common(1)[0]
        raise ValueError(
            f"--board {board.spec}: markers of {name} were seen in {len(marked)} of {len(views)} photos, which a"
            f" chessboard doesn't have; say charuco:COLUMNSxROWS:SQUARE:MARKER:{name} (counting squares) if that is"
            " the board"
        )


def missing(view: BoardView, board: Board) -> str:
    """Why a photograph shows no usable board, in words."""
    if board.kind == "charuco" and view.markers is not None:
        count, name = len(view.markers.numbers), view.markers.dictionary
        if name != board.dictionary or view.markers.misplaced:
            return f"{count} markers of {name} were seen, but not this board"
        return f"{count} markers were seen, but fewer than {MIN_CORNERS} sharp and whole corners between them"
    if board.kind == "charuco" and view.grid is not None:
        return (
            f"a chessboard of {view.grid[0]}x{view.grid[1]} corners was seen, but no markers that can be read"
        )
    if view.markers is not None:
        return f"{len(view.markers.numbers)} markers of {view.markers.dictionary} were seen: is it a charuco board?"
    if view.grid is not None and (np.sort(view.grid) > np.sort(board.corner_counts)).any():
        return f"{view.grid[0]}x{view.grid[1]} corners were seen, more than the board has"
    if view.grid is not None:
        return f"fewer than {MIN_CORNERS} of the board's corners are sharp and inside the picture"
    return "the board was not found: is it in the picture, sharp, evenly lit, and not covered?"


def odd_sizes(views: Sequence[BoardView]) -> dict[str, str]:
    """Why photographs are left out that have another size in pixels than most, in words, by name.

    ValueError if no size is that of more than half of them.
    """
    sizes = Counter(view.size for view in views)
    (usual, count), *others = sizes.most_common()
    turned = bool(others) and all(size == usual[::-1] for size, _ in others)
    remedy = (
        "some were turned to portrait; use the files as the camera wrote them"
        if turned
        else "use photos of one camera at one resolution, not cropped"
    )
    if count <= len(views) / 2:
        listed = ", ".join(
            f"{number} of {width}x{height}" for (width, height), number in sizes.most_common(3)
        )
        raise ValueError(
            f"photos differ in size, and none is that of more than half of the {len(views)}: {listed}"
            f"{', ...' if len(sizes) > 3 else ''} pixels; {remedy}"
        )
    return {
        view.name: f"left out because its size is {view.size[0]}x{view.size[1]} pixels, and {count} of"
        f" {len(views)} photos have {usual[0]}x{usual[1]}; {remedy}"
        for view in views
        if view.size != usual
    }
