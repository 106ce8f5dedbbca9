"""Bags of ROS 1 and ROS 2, and MCAP files, by the package rosbags (extra: ros)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relnav_graph.errors import InputError
from relnav_graph.io.clocks import NANO
from relnav_graph.io.mcap_checksums import check_mcap

__all__ = ["Topic", "bag_in", "read_topics", "topics_in", "types", "write_bag"]

_ENDS = (".bag", ".mcap", ".db3")


def _rosbags() -> Any:
    try:
        import rosbags.highlevel  # an extra: few data are bags
        import rosbags.rosbag1
        import rosbags.rosbag2
        import rosbags.typesys
    except ImportError as error:
        raise InputError("bags need rosbags: install relnav-graph[ros]") from error
    return rosbags


def bag_in(path: Path) -> Path:
    """The bag that a path names: a file .bag, .mcap or .db3, a folder of ROS 2, or a folder with
    one of these in it. Raises InputError on none, and on several."""
    if path.is_file() or (path / "metadata.yaml").is_file():
        return path
    found = sorted(
        p for p in path.iterdir() if p.suffix in _ENDS or (p / "metadata.yaml").is_file()
    )
    if len(found) != 1:
        names = ", ".join(p.name for p in found) or "none"
        raise InputError(f"{path}: found {names}, expected one bag; data.options.file names it")
    return found[0]


@dataclass(frozen=True, eq=False)
class Topic:
    """Messages of a topic in order of their stamps: kind, their type; stamps, and when they were
    received, (N,), ns."""

    name: str
    kind: str
    messages: Sequence[Any]
    stamps: NDArray[np.int64]
    received: NDArray[np.int64]

    def where(self, row: int) -> str:
        """The topic and stamp of a message."""
        second, ns = divmod(int(self.stamps[row]), NANO)
        return f"topic {self.name}, stamp {second}.{ns:09d}"


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A bag, open. Raises InputError on what is none."""
    rosbags = _rosbags()
    typesys = rosbags.typesys
    try:
        usual = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
        with rosbags.highlevel.AnyReader([path], default_typestore=usual) as reader:
            yield reader
    except InputError:
        raise
    except Exception as error:  # it is a stranger's file, read by a stranger's code
        reason = f"{type(error).__name__}: {error}"
        raise InputError(f"{path}: not a readable bag: {reason}") from error


def topics_in(path: Path) -> list[str]:
    """Names of the topics of a bag. Raises InputError on a damaged one."""
    with _opened(path) as reader:
        return sorted({connection.topic for connection in reader.connections})


def read_topics(
    path: Path, names: Sequence[str], kinds: Sequence[str], by_header: bool = True
) -> dict[str, Topic]:
    """Some topics of a bag, by name.

    kinds: types of messages that one may have; by_header: stamps are those of the headers, else the
    times of reception. Raises InputError on topics that are not there,
    naming those that are, on others' types, on a topic without messages, and on a damaged bag.
    """
    with _opened(path) as reader:
        for file in [path] if path.is_file() else sorted(path.glob("*.mcap")):
            if file.suffix == ".mcap":
                check_mcap(file)
        there = {c.topic: c.msgtype for c in reader.connections}
        for name in names:
            if name not in there:
                listed = ", ".join(f"{n} ({k})" for n, k in sorted(there.items())) or "none"
                raise InputError(f"{path}: found no topic {name!r}; there are {listed}")
            if there[name] not in kinds:
                raise InputError(
                    f"{path}: topic {name}: found {there[name]}, expected one of {', '.join(kinds)}"
                )
        found: dict[str, list[tuple[int, int, Any]]] = {name: [] for name in names}
        wanted = [c for c in reader.connections if c.topic in found]
        for connection, received, raw in reader.messages(wanted) if wanted else ():
            message = reader.deserialize(raw, connection.msgtype)
            header = message.header.stamp
            stamp = header.sec * NANO + header.nanosec if by_header else received
            found[connection.topic].append((stamp, received, message))
    return {name: _topic(path, name, there[name], rows) for name, rows in found.items()}


def _topic(path: Path, name: str, kind: str, rows: list[tuple[int, int, Any]]) -> Topic:
    if not rows:
        raise InputError(f"{path}: topic {name}: found no message")
    rows.sort(key=lambda row: row[0])  # a bag has them in the order in which they came
    stamps, received = (np.array([row[i] for row in rows], dtype=np.int64) for i in (0, 1))
    topic = Topic(name, kind, [row[2] for row in rows], stamps, received)
    again = np.nonzero(np.diff(stamps) == 0)[0]
    if len(again):
        raise InputError(
            f"{path}: {topic.where(int(again[0]))}: found {len(again)} messages with the stamp of"
            " another one, expected each once"
        )
    return topic


def types(ros: int) -> Any:
    """The type store of ROS 1 or ROS 2: messages are made and serialised with it."""
    typesys = _rosbags().typesys
    stores = typesys.Stores
    return typesys.get_typestore(stores.ROS1_NOETIC if ros == 1 else stores.ROS2_JAZZY)


def write_bag(path: Path, form: str, topics: Sequence[Topic]) -> None:
    """Write topics, in order of their times of reception, as a bag that is not there yet.

    form: "mcap", one MCAP file; "ros2", a folder of ROS 2 with an MCAP file; "sqlite3", one with a
    .db3 file; "ros1", a file .bag.
    """
    rosbags = _rosbags()
    store = types(1 if form == "ros1" else 2)
    if form == "ros1":
        writer = rosbags.rosbag1.Writer(path)
    else:
        plugins = rosbags.rosbag2.StoragePlugin
        plugin = plugins.SQLITE3 if form == "sqlite3" else plugins.MCAP
        inner = path.with_name(f"{path.name}.parts") if form == "mcap" else path
        writer = rosbags.rosbag2.Writer(inner, version=9, storage_plugin=plugin)
    rows = sorted(
        (int(topic.received[k]), i, k) for i, topic in enumerate(topics) for k in _rows(topic)
    )
    serialize = store.serialize_ros1 if form == "ros1" else store.serialize_cdr
    with writer:
        connections = [writer.add_connection(t.name, t.kind, typestore=store) for t in topics]
        for received, i, k in rows:
            raw = serialize(topics[i].messages[k], topics[i].kind)
            writer.write(connections[i], received, raw)
    if form == "mcap":
        (file,) = inner.glob("*.mcap")
        file.rename(path)


def _rows(topic: Topic) -> range:
    return range(len(topic.messages))
