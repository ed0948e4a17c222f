"""Conversions from and to URLs: sources are downloaded first, and the result is uploaded when it is complete."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple

from pc2scan.errors import DestinationError, Pc2ScanError
from pc2scan.files.parts import unrecorded_warning
from pc2scan.files.places import parts_among

from .scratch import ScratchSpace, SizeLimit, scratch_folder
from .store import RemotePath
from .urls import UrlNames, is_url

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path


class RemoteRequest(NamedTuple):
    """The sources and the destination of a conversion as requested: paths or URLs.

    Attributes
    ----------
    sources, tf_from
        The recordings that are read, and those that only transforms are taken from.
    destination, folder
        The destination, or the folder for it; if both are None, it is next to the first source.
    scratch, scratch_size
        The folder for local copies, and how many bytes it may have; None: the system's folder, and all its free space.
    overwrite, dry_run
        As for local conversions.
    numbered
        Whether the destination may become numbered files.
    """

    sources: Sequence[Path]
    tf_from: Sequence[Path]
    destination: Path | None
    folder: Path | None
    scratch: Path | None
    scratch_size: int | None
    overwrite: bool
    dry_run: bool
    numbered: bool = False


class LocalCopies:
    """The local paths of a conversion.

    Attributes
    ----------
    sources, tf_from, destination, folder
        The local paths of those in `RemoteRequest`.
    names
        Replaces local paths by URLs in texts for users.
    """

    def __init__(self, request: RemoteRequest, scratch: Path) -> None:
        self._request = request
        self._scratch = scratch
        self.names = UrlNames()
        self._read: list[RemotePath] = []
        self._out: RemotePath | None = None
        self._out_folder: Path | None = None
        self._downloads: list[tuple[RemotePath, Path]] = []
        self._number = 0
        self.sources = [self._here(path) for path in request.sources]
        self.tf_from = [self._here(path) for path in request.tf_from]
        self.destination, self.folder = request.destination, request.folder
        self._place_destination()
        #: Limits the size of copies and result; None if the result is not written here, or there is no limit.
        self.limit = self._make_room()
        for place, target in self._downloads:
            target.parent.mkdir(exist_ok=True)
            place.download(target)

    def _here(self, path: Path) -> Path:
        if not is_url(path):
            return path
        place = RemotePath(path)
        folder = self._scratch / str(self._number)
        self._number += 1
        folder.mkdir()
        self.names.add(folder, place.parent)
        target = folder / place.name
        self._read.append(place)
        files = place.files()
        if files is None:
            self._downloads.append((place, target))
        else:
            self._downloads += ((file, target / name) for name, file in files.items())
        return target

    def _place_destination(self) -> None:
        """Determine where the result is uploaded, and raise errors that can be found before anything is read."""
        request = self._request
        first = request.sources[0] if request.sources else None
        if request.destination is not None:
            named = request.destination if is_url(request.destination) else None
        elif request.folder is not None:
            named = request.folder if is_url(request.folder) else None
        else:
            named = first if is_url(first) else None
        if named is None:
            return
        place = RemotePath(named)
        if place.is_read_only:
            hint = "give a destination: `destination=scans.mcap`"
            raise DestinationError(f"{place.scheme}:// can only be read", path=place.shown, hint=hint)
        if named is request.destination:
            read = [each.name for each in self._read if each.folder == place.folder]
            for name in (place.name, *(parts_among(read, place.name) if request.numbered else ())):
                self._refuse_source(RemotePath(named.parent).child(name))
            RemotePath(named.parent).refuse_existing(place.name, overwrite=request.overwrite)
        if named is request.folder:
            self._out = place
            url = place.shown
        else:
            self._out, url = RemotePath(named.parent), place.parent
        if named is first:
            self._out_folder = self.sources[0].parent
            return
        self._out_folder = self._scratch / "out"
        self._out_folder.mkdir()
        self.names.add(self._out_folder, url)
        if named is request.folder:
            self.folder = self._out_folder
        else:
            self.destination = self._out_folder / place.name

    def _make_room(self) -> SizeLimit | None:
        """Raise if the copies would be too large, before anything is read; return the limit of copies and result."""
        request = self._request
        room = ScratchSpace(self._scratch, request.scratch_size)
        needed = sum(place.stat().size for place, _ in self._downloads)
        if needed > room.total:
            error = room.refusal(needed, self._scratch.parent)
            error.path = ", ".join(dict.fromkeys(place.shown for place, _ in self._downloads[:3]))
            raise error
        return (
            None
            if self._out is None or request.scratch_size is None
            else SizeLimit(self._scratch, request.scratch_size)
        )

    def _refuse_source(self, place: RemotePath) -> None:
        """Raise if the result would replace something that is read."""
        if any(place.identity == read.identity for read in self._read):
            raise DestinationError(
                "is a source", path=place.shown, hint="sources are never changed; choose another name"
            )

    def upload(self) -> list[str]:
        """Upload the result, complete or not at all; return warnings."""
        if self._out is None or self._out_folder is None or self._request.dry_run:
            return []
        sources = {*self.sources, *self.tf_from}
        if self.limit is not None:
            self.limit.check()
        # From the last part to the first: if the first part exists, all parts exist.
        made = sorted((path for path in self._out_folder.iterdir() if path not in sources), reverse=True)
        for path in made:
            self._refuse_source(self._out.child(path.name))
            self._out.refuse_existing(path.name, overwrite=self._request.overwrite)
        done: list[str] = []
        try:
            for path in made:
                if path.is_dir():
                    self._out.upload(path, path.name)
                else:
                    done.append(self._out.upload_file(path, path.name))
        except BaseException:
            # If the recording has several files, none of them stays.
            if len(made) > 1:
                self._out.remove(done)
            raise
        target = (
            None if self._request.destination is None or not self._request.numbered else self._request.destination.name
        )
        names = {path.name for path in made}
        if target is None or target in names:
            return []
        there = parts_among((name for name in self._out.below() if "/" not in name), target)
        return unrecorded_warning(target, [name for name in there if name not in names])


@contextmanager
def local_copies(request: RemoteRequest) -> Iterator[LocalCopies]:
    """Make local copies of a conversion's sources, which exist while the context lasts; errors in it name URLs.

    Raises
    ------
    RecordingError
        If a source cannot be read, or changes while it is read.
    UsageError
        If there is not enough space, or the destination cannot be written or exists.
    """
    with scratch_folder(request.scratch) as scratch:
        found: LocalCopies | None = None
        try:
            found = LocalCopies(request, scratch)
            yield found
        except Pc2ScanError as err:
            if found is not None:
                found.names.error(err)
            raise
