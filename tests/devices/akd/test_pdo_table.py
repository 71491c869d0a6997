"""`twin.devices.akd.pdo_table`: Identifiers and mappings of PDOs as CiA 301 has them."""

import pytest

from twin.devices.akd.node_settings import NodeSettings
from twin.devices.akd.object_dictionaries import ObjectDictionaries
from twin.devices.akd.object_names import STATUS, Names
from twin.devices.akd.pdo_table import PdoTable

NODE, MOVED = 5, 0x680
IDENTIFIER, MAPPINGS, FIRST_OBJECT = (0x1800, 1), (0x1A00, 0), (0x1A00, 1)
SAVE = int.from_bytes(b"save", "little")


@pytest.fixture
def bus():
    """A bus of a node, and a function that writes an object of it."""
    objects, settings = ObjectDictionaries(Names(), None, {}, {}), NodeSettings()
    table = PdoTable(objects, settings, {NODE}, 0)

    def write(key, value):
        held = objects.values[NODE]
        settings.take(NODE, key, value, held.get(key), writes=True)
        held[key] = value
        if key[0] >= 0x1400:
            table.take(NODE, key)

    return table, write


def test_a_pdo_has_its_usual_identifier_until_it_is_given_one(bus):
    table, write = bus
    assert table.find(0x185)[:2] == (NODE, "TPDO1")
    assert table.find(0x205)[:2] == (NODE, "RPDO1")
    assert table.find(MOVED) is None
    write(IDENTIFIER, MOVED)
    assert table.find(MOVED)[:2] == (NODE, "TPDO1")
    assert table.find(0x185) is None


def test_a_boot_takes_back_what_was_not_stored(bus):
    table, write = bus
    write(IDENTIFIER, MOVED)
    table.forget(NODE)
    assert table.find(0x185)[:2] == (NODE, "TPDO1")
    write(IDENTIFIER, MOVED)
    write((0x1010, 1), SAVE)
    table.forget(NODE)
    assert table.find(MOVED)[:2] == (NODE, "TPDO1")


def test_a_layout_is_of_data_of_the_length_of_the_mapping_only(bus):
    table, write = bus
    write(FIRST_OBJECT, STATUS << 16 | 16)
    write(MAPPINGS, 1)
    pdo = table.find(0x185)
    assert table.layout(pdo, 8) is None
    (entry,) = table.layout(pdo, 16)
    assert entry[:4] == ((STATUS, 0), "U16", 0, 16)
    assert entry.reports_changes


def test_padding_has_bits_and_no_entry(bus):
    table, write = bus
    write(FIRST_OBJECT, 0x0005 << 16 | 8)  # UNSIGNED8, a data type
    write((0x1A00, 2), STATUS << 16 | 16)
    write(MAPPINGS, 2)
    (entry,) = table.layout(table.find(0x185), 24)
    assert (entry.key, entry.first) == ((STATUS, 0), 8)
