"""The folder of the results in a store: its manifest and its note of unfinished outputs are local files meanwhile.

A store has no locks. Instead, a manifest that another run has written meanwhile is an error.
"""

from __future__ import annotations

import time
from pathlib import PurePosixPath
from typing import TYPE_CHECKING

from pc2scan.errors import DestinationError, MissingError
from pc2scan.files.places import parts_among

from .folder import UNFINISHED, is_numbered, unnumbered_name
from .identity import Identity
from .manifest import MANIFEST

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from pc2scan.files.store import StoredObject
    from pc2scan.files.urls import UrlPath

#: Seconds between two uploads of the manifest, at least.
_PUSH_SECONDS = 10.0


class StoreFolder:
    """The folder of the results in a store.

    The manifest and the note of outputs that are being written are uploaded from time to time while recordings are
    converted, and at the end.

    Parameters
    ----------
    out
        The folder in the store.
    folder
        A local folder for these files, which are fetched.
    """

    def __init__(self, out: UrlPath, folder: Path) -> None:
        self._out = out
        self._folder = folder
        self._pushed: dict[str, bytes] = {}
        self._next = 0.0
        self._objects = {path.relative_to(out).as_posix(): path.known() for path in out.below()}
        self._version = self._manifest_version()
        for name in (MANIFEST, UNFINISHED):
            if name in self._objects:
                self._pushed[name] = (out / name).read_bytes()
                (folder / name).write_bytes(self._pushed[name])

    def _manifest_version(self) -> str | None:
        """Return the version of the manifest in the store; None if there is none."""
        try:
            return (self._out / MANIFEST).known().version
        except MissingError:
            return None

    def present(self, output: str, left: Identity | None = None) -> Identity:
        """Return the identity that an output had when the run began; ``left``: see `identity_in`."""
        return identity_in(self._objects, output, left)

    def existing(self, outputs: Iterable[str]) -> set[str]:
        """Return those outputs that exist now."""
        objects = {path.relative_to(self._out).as_posix(): path.known() for path in self._out.below()}
        names = {str(parent) for key in objects for parent in (key, *PurePosixPath(key).parents)}
        return {each for each in outputs if each in names or (is_numbered(each) and identity_in(objects, each).files)}

    def push(self, *, at_once: bool = False) -> None:
        """Upload the files that have changed, if the last upload is long enough ago.

        Raises
        ------
        DestinationError
            If another run has written the manifest meanwhile.
        OutputError
            If they cannot be written.
        """
        began = time.monotonic()
        if began < self._next and not at_once:
            return
        if self._manifest_version() != self._version:
            raise DestinationError(
                "was changed meanwhile: another batch is writing into this folder",
                path=self._out / MANIFEST,
                hint="let one run end, and run the other one again",
            )
        for name in (UNFINISHED, MANIFEST):
            place, path = (self._out / name).remote, self._folder / name
            data = path.read_bytes() if path.exists() else None
            if data is None and name in self._pushed:
                place.delete()
                del self._pushed[name]
            elif data is not None and data != self._pushed.get(name):
                place.write(data)
                self._pushed[name] = data
                if name == MANIFEST:
                    self._version = self._manifest_version()
        self._next = time.monotonic() + max(_PUSH_SECONDS, 10 * (time.monotonic() - began))


def identity_in(objects: Mapping[str, StoredObject], output: str, left: Identity | None = None) -> Identity:
    """Return the identity of an output (a file, a folder, or numbered files) from a listing of the store.

    ``left`` says which files a numbered output has; without it, all with such names are listed.
    """
    if is_numbered(output):
        folder, _, name = unnumbered_name(output).rpartition("/")
        here = {key.rpartition("/")[2]: found for key, found in objects.items() if key.rpartition("/")[0] == folder}
        names = parts_among(here, name) if left is None else [file for file, _, _ in left.files if file in here]
        return Identity(tuple((name, *here[name][:2]) for name in names))
    if found := objects.get(output):
        return Identity(((output.rpartition("/")[2], found.size, found.version),))
    below = f"{output}/"
    files = [(key[len(below) :], *found[:2]) for key, found in sorted(objects.items()) if key.startswith(below)]
    return Identity(tuple(files))
