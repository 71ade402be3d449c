"""A file on disk as bytes, text, or named arrays; whatever is wrong with it is an `InputError`."""

from __future__ import annotations

import gzip
import io
import zlib
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.io import loadmat

from pedjax.errors import InputError
from pedjax.readers._mat5 import plain_variables

Kind = Literal["npz", "mat", "hdf", "binary", "text"]


@dataclass(frozen=True)
class File:
    """The unpacked bytes of a file; `name` is the file's own name, `stem` that without its endings."""

    path: Path
    data: bytes

    @property
    def name(self) -> str:
        """The file's name, for messages."""
        return self.path.name

    @property
    def stem(self) -> str:
        """The name without `.gz` and without the ending of the format."""
        return Path(_without_gz(self.path).name).stem

    @property
    def kind(self) -> Kind:
        """What the first bytes say the file is."""
        if self.data[:4] == b"PK\x03\x04":
            return "npz"
        if self.data[:8] == b"\x89HDF\r\n\x1a\n" or self.data[:10] == b"MATLAB 7.3":
            return "hdf"
        if self.data[:10] == b"MATLAB 5.0" or _without_gz(self.path).suffix.lower() == ".mat":
            return "mat"
        if _without_gz(self.path).suffix.lower() == ".npz":
            return "npz"
        return "binary" if b"\0" in self.data[:4096] else "text"

    @cached_property
    def text(self) -> str:
        """The whole file as text (UTF-8, else Latin-1), without quotation marks."""
        try:
            text = self.data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = self.data.decode("latin-1")
        return text.replace('"', "")

    @cached_property
    def lines(self) -> list[str]:
        """The lines of the text, without trailing blank ones."""
        lines = self.text.splitlines()
        while lines and not lines[-1].strip():
            lines.pop()
        return lines

    @property
    def head(self) -> list[str]:
        """The first lines, by which a text format is recognised; empty for what is no text."""
        if self.kind != "text":
            return []
        return self.data[:16384].decode("utf-8", "replace").replace('"', "").splitlines()[:40]

    @cached_property
    def arrays(self) -> dict[str, Any]:
        """The named arrays of an npz or mat file."""
        # numpy and scipy raise nearly anything on a damaged file
        if self.kind == "npz":
            try:
                with np.load(io.BytesIO(self.data), allow_pickle=False) as archive:
                    return {name: archive[name] for name in archive.files}
            except Exception as error:
                raise InputError(
                    f"{self.name}: it is no readable npz archive ({_brief(error)}); copy or export it again"
                ) from error
        if self.kind == "mat":
            try:
                contents = loadmat(io.BytesIO(self.data), variable_names=plain_variables(self.data))
            except Exception as error:
                raise InputError(
                    f"{self.name}: it is no readable MATLAB file ({_brief(error)}); copy it again, or save "
                    "it anew with save(..., '-v7')"
                ) from error
            return {name: value for name, value in contents.items() if not name.startswith("__")}
        return {}

    def array(self, name: str) -> np.ndarray:
        """The array of that name as float64."""
        if name not in self.arrays:
            raise InputError(
                f"{self.name}: there is no array '{name}'; the file has {', '.join(sorted(self.arrays))}"
            )
        return numeric(self.arrays[name], f"{self.name}: array '{name}'")

    def whole(self, name: str) -> np.ndarray:
        """The array of that name as a row of whole numbers."""
        value = self.array(name).ravel()
        if len(value) == 0 or not (np.isfinite(value) & (value == np.rint(value))).all():
            raise InputError(f"{self.name}: array '{name}' must hold whole numbers; correct it")
        return value.astype(int)

    def matrix(self, name: str, columns: int) -> np.ndarray:
        """The array of that name with `columns` columns; turned where it lies on its side."""
        value = self.array(name)
        if value.ndim == 2 and value.shape[1] != columns and value.shape[0] == columns:
            value = value.T
        if value.ndim != 2 or value.shape[1] != columns:
            raise InputError(
                f"{self.name}: array '{name}' has shape {value.shape} where (N, {columns}) is needed"
            )
        return value


def numeric(value: Any, where: str) -> np.ndarray:
    """`value` as float64, or an `InputError` that begins with `where`."""
    try:
        return np.asarray(value).astype(np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{where} holds {np.asarray(value).dtype} where numbers are needed; export it as plain numbers"
        ) from error


def load(path: str | PathLike[str]) -> File:
    """Read and unpack a file."""
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: this is a folder; name one recording in it")
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise InputError(f"{path}: there is no such file; check the path") from error
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: it cannot be opened ({_brief(error)}); check the path and rights"
        ) from error
    if data[:2] == b"\x1f\x8b":
        try:
            data = gzip.decompress(data)
        except (OSError, EOFError, zlib.error) as error:
            raise InputError(
                f"{path.name}: the gzip data are damaged or cut off ({_brief(error)}); copy the file again"
            ) from error
    elif path.suffix == ".gz" and data:
        raise InputError(f"{path.name}: it ends in .gz but is no gzip file; rename it, or copy it again")
    if not data.strip():
        raise InputError(f"{path.name}: the file is empty; copy or record it again")
    return File(path, data)


def _without_gz(path: Path) -> Path:
    return path.with_suffix("") if path.suffix == ".gz" else path


def _brief(error: Exception) -> str:
    text = str(error).splitlines()
    return (text[0] if text else type(error).__name__).rstrip(".")
