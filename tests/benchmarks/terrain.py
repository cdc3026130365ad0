"""What terrain costs: memory with a raster of 10 000 x 10 000, and time of a flight over it.

    python tests/benchmarks/terrain.py [FOLDER]

writes a GeoTIFF of 400 MB into a folder, smooths a flight of 5000 bearings over it in a process of
its own, with and without the ground, and prints the process's greatest memory and the times.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

SIZE, SPACING, BAND = 10_000, 10.0, 500


def ground(x, y):
    """Return the height of hills and ridges, metres."""
    return (
        300.0
        + 120.0 * np.sin(x / 700.0) * np.cos(y / 900.0)
        + 200.0 * np.sin((x + 2.0 * y) / 4500.0)
    )


def write_raster(path: Path) -> None:
    """Write the raster band by band."""
    import rasterio
    from rasterio.transform import Affine
    from rasterio.windows import Window

    x = SPACING * (0.5 + np.arange(SIZE))
    with rasterio.open(
        path, "w", driver="GTiff", height=SIZE, width=SIZE, count=1, dtype="float32", tiled=True,
        blockxsize=256, blockysize=256, transform=Affine(SPACING, 0, 0, 0, SPACING, 0),
    ) as dataset:  # fmt: skip
        for row in range(0, SIZE, BAND):
            y = SPACING * (0.5 + np.arange(row, row + BAND))
            height = ground(x[None, :], y[:, None]).astype(np.float32)
            dataset.write(height, 1, window=Window(0, row, SIZE, BAND))


def flight(path: Path):
    """Return a recording of an emitter on the ground from a flight of 5000 bearings."""
    import geograph as gg

    clock = 0.1 * np.arange(5000)
    turn = 60.0 / 2500.0 * clock
    place = np.column_stack(
        [50e3 + 2500.0 * np.sin(turn), 50e3 + 2500.0 * np.cos(turn), 1500.0 + 0.0 * turn]
    )
    emitter = np.array([52e3, 51.5e3, ground(52e3, 51.5e3)])
    sight = emitter - place
    sigma = np.radians(2.0)
    noise = sigma * np.random.default_rng(1).normal(size=(2, clock.size))
    elevation = np.arctan2(sight[:, 2], np.hypot(sight[:, 0], sight[:, 1]))
    bearings = gg.Bearings(
        time_s=clock, sensor=np.zeros(clock.size, dtype=np.int64),
        azimuth_rad=np.arctan2(sight[:, 1], sight[:, 0]) + noise[0] / np.cos(elevation),
        elevation_rad=elevation + noise[1], sigma_azimuth_rad=np.full(clock.size, sigma),
        sigma_elevation_rad=np.full(clock.size, sigma), isotropic=np.ones(clock.size, dtype=bool),
        line=np.arange(clock.size),
    )  # fmt: skip
    held = gg.Constraints(
        time_s=np.array([np.nan]), kind=("height_above_terrain_m",), value=np.zeros(1),
        sigma=np.full(1, 5.0), line=np.zeros(1, dtype=np.int64),
    )  # fmt: skip
    sensor = gg.Sensor(name="A", trajectory=gg.Trajectory(clock, place), axes="xyz")
    with_ground = gg.Recording(
        name="flight", frame="local", sensors={"A": sensor}, bearings=bearings, constraints=held,
        terrain=gg.Terrain.from_file(str(path), frame="local"),
        settings=gg.SmoothSettings(motion="static"),
    )  # fmt: skip
    return with_ground, emitter


def measure(path: Path) -> None:
    """Smooth with and without the ground; print times, errors and memory."""
    from dataclasses import replace

    import geograph as gg

    with_ground, emitter = flight(path)
    without = replace(with_ground, constraints=None, terrain=None)
    gg.smooth(without)
    for name, recording in (("without", without), ("with", with_ground)):
        took = []
        for _ in range(5):
            began = time.perf_counter()
            track = gg.smooth(recording)
            took.append(time.perf_counter() - began)
        error = np.linalg.norm(track.position_m[0] - emitter)
        first = f"first {took[0]:.2f} s, then {np.median(took[1:]):.2f} s"
        print(f"{name:8s} the ground: {first}; error {error:.1f} m")
    # Of this process alone: the figure of getrusage is at least what its parent had.
    status = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    greatest = next(int(line.split()[1]) / 1024.0 for line in status if line.startswith("VmHWM"))
    print(f"greatest memory of the process: {greatest:.0f} MB")


def main(arguments: list[str]) -> None:
    """Write the raster and measure in another process."""
    if arguments[:1] == ["--measure"]:
        measure(Path(arguments[1]))
        return
    with tempfile.TemporaryDirectory(dir=arguments[0] if arguments else None) as folder:
        path = Path(folder) / "ground.tif"
        write_raster(path)
        subprocess.run([sys.executable, __file__, "--measure", str(path)], check=True)


if __name__ == "__main__":
    main(sys.argv[1:])
