"""Exported runs as other programs read them: columns and units by name."""

import re

import numpy as np
import pyarrow.parquet as pq
import scipy.io
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory


def from_csv(file):
    header, *rows = file.read_text(encoding="utf-8").splitlines()
    heads = [re.fullmatch(r"(\w+) \[(.+)\]", each).groups() for each in header.split(",")]
    values = np.array([[float(cell) for cell in row.split(",")] for row in rows]).T
    return dict(zip([name for name, _ in heads], values, strict=True)), dict(heads)


def from_mat(file):
    found = scipy.io.loadmat(file, simplify_cells=True)
    return {name: found[name] for name in found["units"]}, found["units"]


def from_parquet(file):
    table = pq.read_table(file)
    units = {each.name: each.metadata[b"unit"].decode() for each in table.schema}
    return {name: table[name].to_numpy() for name in units}, units


def from_mcap(file):
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        told = list(reader.iter_decoded_messages(topics=["/signals"]))
    units = dict(re.findall(r"^float64 (\w+)  # (.+)$", told[0][0].data.decode(), re.MULTILINE))
    return {name: [getattr(each[3], name) for each in told] for name in units}, units


READERS = {".csv": from_csv, ".mat": from_mat, ".parquet": from_parquet, ".mcap": from_mcap}
