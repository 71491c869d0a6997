"""What a decoded trace holds as a whole: nodes, signals, PDOs and rhythms as data, and remarks."""

from __future__ import annotations

import math
from typing import Any

from twin.base.errors import plural
from twin.devices.akd.decoding import Conversation


def summarise(decoded: Conversation) -> dict[str, Any]:
    """The output of ``--json``, without the events."""
    nodes = {f"{each}": {**vars(node), "signals": {}} for each, node in decoded.nodes.items()}
    for (number, key), series in decoded.series.items():
        known = [value for value in series.counts if math.isfinite(value)]
        if known and not decoded.objects.reports_changes(number, key):
            factor, unit = decoded.objects.scale(number, key)
            ends = [each(known) * (factor if unit else 1) for each in (min, max)]
            low, high = sorted(ends)
            its = {"from": low, "to": high, "unit": unit}
            nodes[f"{number}"]["signals"][decoded.objects.name(number, key)] = its
    pdos = {
        f"{cob_id:03X}h": pdo._asdict()
        | {"entries": [decoded.objects.name(pdo.node, k) for k, _ in pdo.entries]}
        for cob_id, pdo in decoded.pdos.items()
    }
    strangers = {f"{each:03X}h": count for each, count in decoded.strangers.items()}
    return {"begin": decoded.begin, "duration": decoded.duration, "nodes": nodes, "pdos": pdos} | {
        "regular": {
            decoded.label(stream): rhythm.summary()
            for stream, rhythm in decoded.observed.rhythms.items()
        },
        "strangers": strangers,
        "errors": dict(decoded.errors),
    }


def list_remarks(decoded: Conversation) -> list[str]:
    """Facts reported nowhere else: frames that are left out, a file of a different vendor."""
    remarks = []
    if decoded.echoes:
        remarks.append(f"left out: {plural(decoded.echoes, 'frame')} that the adapter handed back")
    others = decoded.strangers - decoded.long_identifiers
    kinds = {
        "with 29-bit identifiers, no CANopen": decoded.long_identifiers,
        "of no known service": others,
    }
    for kind, counts in kinds.items():
        if counts:
            shown = ", ".join(f"{each:X}h" for each in list(counts)[:3])
            if len(counts) > 3:
                shown += ", ..."
            remarks.append(f"not decoded: {plural(counts.total(), 'frame')} {kind} ({shown})")
    remarks += [
        f"{decoded.called(node)}: the trace does not show what its PDOs carry: decoded by "
        "the defaults of CiA 402, as if it was a drive"
        for node in sorted({node for node, _ in decoded.series} - decoded.described)
        if not decoded.objects.has_known_kind(node)
    ]
    has_sheet = bool(decoded.names.sheet.objects)
    for node in sorted(decoded.nodes):
        if has_sheet and not decoded.objects.is_of_sheet(node):
            vendors = decoded.names.sheet.vendor or 0, decoded.objects.vendor(node) or 0
            remarks.append(
                f"{decoded.called(node)}: the EDS file is not used: it is of vendor "
                f"{vendors[0]:X}h, the node of {vendors[1]:X}h"
            )
    return remarks
