"""Conversion: other formats into recordings, results into other formats."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geograph.errors import InputError
from geograph.io.atomic import check_replaceable
from geograph.io.ecsv import PerCamera, ecsv_files, read_ecsv
from geograph.io.messages import expected_one_of, listed, shown
from geograph.io.reader import read
from geograph.io.source import FOREIGN_SUFFIXES, HEADER_NAME
from geograph.io.writer import TableFormat, write

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from geograph.io.stations import Station
    from geograph.recording import Recording
    from geograph.sensors import Sensor

_RESULTS_MARK = "summary.json"
_BY_SUFFIX = {".zip": "recording"} | FOREIGN_SUFFIXES
FORMATS = ("recording", "results", "ecsv", "tdm", "iod", "uk", "mpc", "mapped")
"""Formats that are read, by the names that they have on the command line."""


@dataclass(frozen=True, kw_only=True)
class ForeignOptions:
    """What files of other formats do not say, for :func:`convert`.

    Parameters
    ----------
    format
        One of ``FORMATS``; None: by the suffix.
    stations
        Station list, or sensors by name.
    mapping
        Mapping file of tables of any layout, or a dictionary of its shape.
    target
        The object, where files have several.
    ignore
        Keywords of tracking data messages to be passed over.
    sigma_s, sigma_hz, carrier_hz
        For differences, whose format has no sigmas.
    """

    format: str | None = None
    stations: Mapping[str, Station | Sensor] | Path | str | None = None
    mapping: Mapping[str, Any] | Path | str | None = None
    target: str | None = None
    ignore: tuple[str, ...] = ()
    sigma_s: float | None = None
    sigma_hz: float | None = None
    carrier_hz: float | None = None


def convert(
    inputs: Sequence[Path | str],
    output: Path | str,
    *,
    tables: TableFormat = "csv",
    clock_offset_s: PerCamera | None = None,
    bias_deg: PerCamera | None = None,
    sigma_deg: PerCamera | None = None,
    foreign: ForeignOptions | None = None,
    overwrite: bool = False,
) -> Recording | None:
    """Write what was read in one format in another.

    Parameters
    ----------
    inputs
        Files of one foreign format, which make one recording (docs/formats.md); or one recording, a
        folder or a .zip archive; or one folder of results.
    output
        The recording to write: a folder, or a .zip archive if its name ends so. Of results: a file
        that ends in .oem, .geojson, .kml, .czml or .parquet.
    tables
        Format of a recording's tables, ``"csv"`` or ``"parquet"``.
    clock_offset_s, bias_deg, sigma_deg
        Of the sensors; by default as the format or the station list has it, for fireball files see
        :func:`geograph.io.read_ecsv`. Not for recordings, which have their own.
    foreign
        What else files of other formats do not say.
    overwrite
        Whether what is in place of ``output`` is replaced.

    Returns
    -------
    Recording
        As read back from what was written; None for results.

    Raises
    ------
    InputError
        If an input is wrong, inputs of different formats are mixed, or the output is in use.
    """
    paths = [Path(path) for path in inputs]
    target = Path(output)
    options = ForeignOptions() if foreign is None else foreign
    if not paths:
        raise InputError("nothing to convert; expected files, a folder or a .zip archive")
    given = {"clock_offset_s": clock_offset_s, "bias_deg": bias_deg, "sigma_deg": sigma_deg}
    kind = _kind(paths, options)
    if kind == "results":
        _export(paths, target, overwrite=overwrite)
        return None
    if target.suffix.lower() in _export_suffixes():
        raise InputError(
            f"is written from results, and {paths[0]} is none; expected a folder that geograph "
            "smooth wrote; smooth first",
            path=target,
        )
    if target.suffix.lower() != ".zip" and not overwrite:
        check_replaceable(target, markers=())
    if kind == "recording":
        recording = _one_recording(paths, given, options)
    elif kind == "ecsv":
        chosen = {name: value for name, value in given.items() if value is not None}
        recording = read_ecsv(ecsv_files(paths), name=target.stem, **chosen)  # type: ignore[arg-type]
    else:
        recording = _read_foreign(kind, paths, target.stem, given, options)
    return write(recording, target, overwrite=overwrite, tables=tables)


def _export_suffixes() -> tuple[str, ...]:
    from geograph.export.by_suffix import SUFFIXES

    return SUFFIXES


def _kind(paths: Sequence[Path], options: ForeignOptions) -> str:
    """Return the one format of all inputs."""
    if options.format is not None:
        if options.format not in FORMATS:
            raise InputError(
                f"unknown format {shown(options.format)}; "
                f"{expected_one_of(options.format, FORMATS)}"
            )
        return options.format
    if options.mapping is not None:
        return "mapped"
    kinds = [_kind_of(path) for path in paths]
    for path, kind in zip(paths, kinds, strict=True):
        if kind != kinds[0]:
            what = "is not an .ecsv file or a folder of them" if kinds[0] == "ecsv" else (
                f"is {kind}, and {paths[0]} is {kinds[0]}"
            )  # fmt: skip
            raise InputError(
                f"{what}; expected one format; convert recordings by themselves", path=path
            )
    return kinds[0]


def _kind_of(path: Path) -> str:
    if path.is_dir():
        names = {entry.name for entry in path.iterdir()}
        if HEADER_NAME not in names:
            if _RESULTS_MARK in names:
                return "results"
            if any(name.lower().endswith(".ecsv") for name in names):
                return "ecsv"
        return "recording"
    kind = _BY_SUFFIX.get(path.suffix.lower())
    if kind is None and path.is_file():
        # The reader of recordings says what is wrong with a header given for its folder.
        if path.name == HEADER_NAME:
            return "recording"
        if _is_tracking_message(path):
            return "tdm"
        raise InputError(
            f"ends in {shown(path.suffix)}, which says no format; expected one of "
            f"{listed(_BY_SUFFIX)}; say it (--format), or give a mapping (--mapping)",
            path=path,
        )
    return kind or "recording"


def _is_tracking_message(path: Path) -> bool:
    """Tell whether a file of any suffix begins as a tracking data message does."""
    try:
        with path.open("rb") as file:
            return b"CCSDS_TDM_VERS" in file.read(400)
    except OSError:
        return False


def _one_recording(
    paths: Sequence[Path], given: Mapping[str, object], options: ForeignOptions
) -> Recording:
    if len(paths) > 1:
        raise InputError(
            f"{len(paths)} recordings; expected one, or .ecsv files; convert one at a time",
            path=paths[1],
        )
    recording = read(paths[0])
    if any(value is not None for value in given.values()) or options != ForeignOptions(
        format=options.format
    ):
        raise InputError(
            "is a recording, which has its own sensors, sigmas and priors; expected no options but "
            "for its tables (no clock_offset_s, bias_deg or sigma_deg); edit the recording",
            path=paths[0],
        )
    return recording


def _read_foreign(
    kind: str,
    paths: Sequence[Path],
    name: str,
    given: Mapping[str, PerCamera | None],
    options: ForeignOptions,
) -> Recording:
    from geograph.io.rows import ImportOptions
    from geograph.io.stations import as_stations

    chosen = ImportOptions(
        stations=as_stations(options.stations),
        sigma_s=options.sigma_s,
        sigma_hz=options.sigma_hz,
        carrier_hz=options.carrier_hz,
        name=name,
        **given,  # type: ignore[arg-type]
    )
    if kind == "tdm":
        from geograph.io.tdm import read_tdm

        return read_tdm(paths, chosen, ignore=options.ignore, target=options.target)
    if kind == "mapped":
        from geograph.io.mapped import read_mapped

        if options.mapping is None:
            raise InputError("needs a mapping (--mapping, or mapping=)", path=paths[0])
        return read_mapped(paths, options.mapping, chosen)
    return _report_reader(kind)(paths, chosen, target=options.target)


def _report_reader(kind: str) -> Callable[..., Recording]:
    if kind == "iod":
        from geograph.io.iod import read_iod

        return read_iod
    if kind == "uk":
        from geograph.io.uk import read_uk

        return read_uk
    from geograph.io.mpc import read_mpc

    return read_mpc


def _export(paths: Sequence[Path], target: Path, *, overwrite: bool) -> None:
    suffixes = _export_suffixes()
    if len(paths) > 1:
        raise InputError(
            f"{len(paths)} results; expected one; convert one at a time", path=paths[1]
        )
    if target.suffix.lower() not in suffixes:
        raise InputError(
            f"ends in {shown(target.suffix)}, and {paths[0]} is results; expected a name that ends "
            f"in {', '.join(suffixes)}",
            path=target,
        )
    if target.exists() and not overwrite:
        raise InputError("is there already; name another or allow to overwrite", path=target)
    from geograph.export.by_suffix import write as export
    from geograph.results import load

    export(load(paths[0]), target)
