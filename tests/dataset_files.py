"""Small datasets in their published layouts: a folder of each, and arrays from which it was written."""

from __future__ import annotations

import gzip
import json
import zipfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

WIDTH, HEIGHT, FRAMES = 40, 24, 13

Array = npt.NDArray[Any]


def write_frames(folder: Path, pattern: str, *, seed: int = 0, frames: int = FRAMES) -> Array:
    """Pictures of noise, RGB [T, H, W, 3]; of .jpg their content is about this."""
    folder.mkdir(parents=True, exist_ok=True)
    pictures = np.random.default_rng(seed).integers(0, 256, (frames, HEIGHT, WIDTH, 3), np.uint8)
    for number, picture in enumerate(pictures):
        cv2.imwrite(str(folder / pattern.format(number)), picture[..., ::-1])
    return pictures


def walks(points: int, seed: int = 0, frames: int = FRAMES) -> Array:
    """Tracks [T, N, 2] (x, y) in pixels, well inside the image, float32."""
    random = np.random.default_rng(seed)
    start = random.uniform(6, [WIDTH - 7, HEIGHT - 7], (points, 2))
    return (start + np.cumsum(random.normal(0, 0.3, (frames, points, 2)), axis=0)).astype(np.float32)


def write_pointodyssey(root: Path, scene: str = "r5_new_f", points: int = 9, **changed: Any) -> dict[str, Array]:
    """A scene of a split."""
    write_frames(root / scene / "rgbs", "rgb_{:05d}.jpg")
    random = np.random.default_rng(1)
    visibs = random.random((FRAMES, points)) < 0.8
    visibs[0] = True
    arrays = {"trajs_2d": walks(points), "visibs": visibs, "valids": np.ones((FRAMES, points), bool)}
    arrays = {key: value for key, value in {**arrays, **changed}.items() if value is not None}
    np.savez(root / scene / "anno.npz", **arrays)
    return arrays


def write_egopoints(root: Path, sequence: str = "P01_01_start_1_end_13", points: int = 6, **changed: Any) -> dict:
    """A sequence: every third frame has positions and visibilities."""
    write_frames(root / sequence / "rgbs", "frame_{:010d}.jpg")
    random = np.random.default_rng(2)
    annotated = np.arange(FRAMES)[:, None] % 3 == np.zeros((1, points))
    out_of_view = annotated & (random.random(annotated.shape) < 0.3)
    out_of_view[0] = False
    occluded = annotated & ~out_of_view & (random.random(annotated.shape) < 0.2)
    occluded[0] = False
    valids = annotated & ~out_of_view & ~occluded
    arrays = {
        "trajs_2d": np.where(valids[..., None], walks(points), 0),
        **{"valids": valids, "visibs": valids, "vis_valids": annotated},
        **{"out_of_view": out_of_view, "occluded": occluded},
    }
    arrays = {key: value if value.ndim == 3 else value.astype(np.float32) for key, value in arrays.items()}
    arrays = {key: value for key, value in {**arrays, **changed}.items() if value is not None}
    np.savez(root / sequence / "annot.npz", **arrays)
    return arrays


def write_dynamic_replica(root: Path, sequence: str = "009850-3_obj_source", points: int = 7) -> dict[str, Array]:
    """A split `valid` with one sequence of both cameras; saved by torch."""
    import torch

    random = np.random.default_rng(3)
    visible = random.random((FRAMES, points)) < 0.95
    visible[0] = np.arange(points) % 2  # some are first visible later
    visible[:, -1] = False  # and one is not asked for
    entries = []
    for camera in ("left", "right"):
        folder = f"{sequence}_{camera}"
        write_frames(root / folder / "images", folder + "-{:04d}.png", seed=camera == "right")
        (root / folder / "trajectories").mkdir()
        for number in range(FRAMES):
            trajectories = f"{folder}/trajectories/{number:06d}.pth"
            tensors = {
                "traj_2d": torch.tensor(np.dstack([walks(points), np.ones((FRAMES, points))])[number]).float(),
                "verts_inds_vis": torch.tensor(visible[number]),
                "img": torch.zeros((HEIGHT, WIDTH, 3), dtype=torch.uint8),
            }
            torch.save(tensors, root / trajectories)
            image = {"path": f"{folder}/images/{folder}-{number:04d}.png", "size": [HEIGHT, WIDTH]}
            told = {"sequence_name": sequence, "frame_number": number, "camera_name": camera, "image": image}
            entries.append({**told, "trajectories": {"path": trajectories}})
    write_annotations(root, entries)
    return {"xy": walks(points), "visible": visible}


def write_annotations(root: Path, entries: Any) -> Path:
    """Of Dynamic Replica."""
    file = root / "frame_annotations_valid.jgz"
    file.write_bytes(gzip.compress(json.dumps(entries).encode()))
    return file


def write_badja(root: Path, animal: str = "horsejump-high", begin: int = 2, **changed: Any) -> dict[str, Array]:
    """An animal in its clip of DAVIS, every fourth frame annotated from `begin` on, some joints hidden at first."""
    write_frames(root / "DAVIS/JPEGImages/Full-Resolution" / animal, "{:05d}.jpg")
    masks = np.zeros((FRAMES, HEIGHT, WIDTH), np.uint8)
    folder = root / "DAVIS/Annotations/Full-Resolution" / animal
    folder.mkdir(parents=True)
    for number, mask in enumerate(masks):
        mask[4 : 12 + number % 3, 5:20] = 255
        cv2.imwrite(str(folder / f"{number:05d}.png"), mask)
    random = np.random.default_rng(4)
    numbers = np.arange(begin, FRAMES, 4)
    joints = random.uniform(4, [HEIGHT - 5, WIDTH - 5], (len(numbers), 37, 2))
    visible = random.random((len(numbers), 37)) < 0.8
    entries = [
        {
            "image_path": f"DAVIS/JPEGImages/Full-Resolution/{animal}/{number:05d}.jpg",
            "segmentation_path": f"DAVIS/Annotations/Full-Resolution/{animal}/{number:05d}.png",
            "joints": joints[index].tolist(),
            "visibility": visible[index].tolist(),
            **changed,
        }
        for index, number in enumerate(numbers)
    ]
    write_joints(root, f"{animal}.json", entries)
    return {"numbers": numbers, "joints": joints, "visible": visible, "masks": masks}


def write_joints(root: Path, name: str, entries: Any) -> Path:
    """Of BADJA."""
    (root / "joint_annotations").mkdir(exist_ok=True)
    file = root / "joint_annotations" / name
    file.write_text(json.dumps(entries))
    return file


def repacked(file: Path, changed: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> bytes:
    """A zip archive's bytes with the content of some members, by the end of their names, replaced."""
    with zipfile.ZipFile(file) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    for end, content in changed.items():
        members = {name: content if name.endswith(end) else old for name, old in members.items()}
    there = file.with_suffix(".repacked")
    with zipfile.ZipFile(there, "w", compression) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    content = there.read_bytes()
    there.unlink()
    return content
