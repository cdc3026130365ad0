"""Parquet files as tables, with the columns of the CSV files (needs pyarrow)."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.errors import InputError
from geograph.io.messages import plain, shown
from geograph.io.tables import ColumnSpec, Kind, Table, TextBuilder, TextColumn, match_columns

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

_FIRST_ROW_LINE = 2


def import_parquet(place: Path) -> tuple[Any, Any]:
    """Return the modules pyarrow and pyarrow.parquet.

    Raises
    ------
    InputError
        If pyarrow is not installed.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise InputError(
            "is a Parquet file and pyarrow is not installed; run pip install 'geograph[parquet]'",
            path=place,
        ) from None
    return pyarrow, pyarrow.parquet


def parse_parquet(content: bytes, place: Path, specs: Sequence[ColumnSpec]) -> Table:
    """Return the table in a Parquet file; a null is an empty cell.

    Parameters
    ----------
    content
        The file.
    place
        How it is called in messages.
    specs
        The columns it may have.

    Raises
    ------
    InputError
        See :func:`geograph.io.tables.read_table`.
    """
    _, parquet = import_parquet(place)
    if not content:
        raise InputError("is empty; expected a Parquet table", path=place)
    try:
        # ParquetFile rather than read_table: it never looks at the names of folders around it.
        with parquet.ParquetFile(io.BytesIO(content)) as file:
            arrow = file.read()
        names = [str(name) for name in arrow.column_names]
        arrow.validate(full=True)
    # Damaged files end in errors of many kinds: Arrow's own, OSError, UnicodeDecodeError, ...
    except Exception as error:
        raise InputError(
            f"is not a whole Parquet file ({str(error)[:120]}); write it again", path=place
        ) from None
    matched = match_columns(names, specs, place, line=None)
    numbers: dict[str, NDArray[np.float64]] = {}
    texts: dict[str, TextColumn] = {}
    for index, (name, spec) in enumerate(zip(names, matched, strict=True)):
        column = arrow.column(index)
        try:
            if spec.is_text:
                texts[name] = _text_column(column, name, spec, place)
            else:
                numbers[name] = _number_column(column, name, spec, place)
        except InputError:
            raise
        except Exception as error:
            raise InputError(
                f"cannot be decoded ({str(error)[:120]}); write the file again",
                path=place,
                column=plain(name),
            ) from None
    line = np.arange(arrow.num_rows, dtype=np.int64) + _FIRST_ROW_LINE
    return Table(place=place, line=line, numbers=numbers, texts=texts)


def _number_column(column: Any, name: str, spec: ColumnSpec, place: Path) -> NDArray[np.float64]:
    import pyarrow

    kind = column.type
    if not (
        pyarrow.types.is_integer(kind)
        or pyarrow.types.is_floating(kind)
        or pyarrow.types.is_null(kind)
    ):
        raise InputError(
            f"holds {shown(str(kind))}; expected numbers (double)", path=place, column=plain(name)
        )
    empty = np.asarray(column.is_null().to_numpy(), dtype=bool)
    values = np.asarray(column.cast(pyarrow.float64(), safe=False).to_numpy(), dtype=np.float64)
    # A NaN of a file written by pandas may be a null; one that is not null was computed.
    bad = ~np.isfinite(values) & ~empty
    if not spec.may_be_empty:
        bad |= empty
    if bad.any():
        row = int(np.argmax(bad))
        given = "empty cell" if empty[row] else f"{values[row]} is not a finite number"
        instead = "leave the cell empty (null)" if spec.may_be_empty else "remove the row"
        raise InputError(
            f"{given}; expected a finite number; fill it in or {instead}",
            path=place,
            line=row + _FIRST_ROW_LINE,
            column=plain(name),
        )
    return np.where(empty, np.nan, values)


def _text_column(column: Any, name: str, spec: ColumnSpec, place: Path) -> TextColumn:
    import pyarrow

    kind = column.type
    if pyarrow.types.is_dictionary(kind):
        column, kind = column.cast(kind.value_type), kind.value_type
    number = pyarrow.types.is_integer(kind) or pyarrow.types.is_floating(kind)
    if not (
        pyarrow.types.is_string(kind)
        or pyarrow.types.is_large_string(kind)
        or (number and spec.kind is Kind.LABEL)
    ):
        expected = "text (string) or numbers" if spec.kind is Kind.LABEL else "text (string)"
        raise InputError(
            f"holds {shown(str(kind))}; expected {expected}", path=place, column=plain(name)
        )
    if column.null_count:
        row = int(np.argmax(column.is_null().to_numpy()))
        raise InputError(
            "empty cell; expected text; fill it in or remove the row",
            path=place,
            line=row + _FIRST_ROW_LINE,
            column=plain(name),
        )
    builder = TextBuilder()
    # A number is the label that it would be in a CSV file.
    builder.extend([str(value).strip() for value in column.to_pylist()])
    return builder.column()


def parquet_bytes(columns: Mapping[str, NDArray[np.float64] | Sequence[str]], place: Path) -> bytes:
    """Return a Parquet file of columns; NaN is written as null.

    Parameters
    ----------
    columns
        Numbers or texts by name, all of one length.
    place
        How the file is called in messages.

    Raises
    ------
    InputError
        If pyarrow is not installed.
    """
    pyarrow, parquet = import_parquet(place)
    arrays = {
        name: (
            pyarrow.array(values, mask=np.isnan(values))
            if isinstance(values, np.ndarray)
            else pyarrow.array(list(values), pyarrow.string())
        )
        for name, values in columns.items()
    }
    file = io.BytesIO()
    parquet.write_table(pyarrow.table(arrays), file, compression="zstd")
    return file.getvalue()
