"""`twin.devices.akd.eds`.

Data sheets as they are met: what is at fault costs itself, and a DCF has the device's values."""

import can
import pytest

from twin.base.errors import LogError
from twin.devices.akd.conversation_summary import list_remarks, summarise
from twin.devices.akd.decoding import Conversation
from twin.devices.akd.eds import read_data_sheet
from twin.devices.akd.object_names import Names

SHEET = """[FileInfo]
FileName=a.eds
[DeviceInfo]
VendorName=Müller
VendorNumber=0x123
[1000]
ParameterName=Device type
DataType=0x0007
DefaultValue=0x20192
[2300]
ParameterName=Spannung über Phase
ObjectType=0x7
DataType=0x0008
PDOMapping=1
[2301]
ParameterName=Way
DataType=0x15
[2302]
ParameterName=Picture
DataType=0xF
[1800]
ParameterName=TPDO 1
ObjectType=0x9
SubNumber=2
[1800sub0]
ParameterName=Number
DataType=0x5
DefaultValue=1
[1800sub1]
ParameterName=COB-ID
DataType=0x7
DefaultValue=$NODEID+0x280
[1A00]
ParameterName=TPDO 1 mapping
ObjectType=0x9
SubNumber=3
[1A00sub0]
ParameterName=Number
DataType=0x5
DefaultValue=1
[1A00sub1]
ParameterName=Entry 1
DataType=0x7
DefaultValue=0x23000020
[2400]
ParameterName=Limits
ObjectType=0x8
DataType=0x3
CompactSubObj=3
[2400Name]
NrOfEntries=2
1=Lower
2=Upper
"""


def sheet(tmp_path, text, name="a.eds", encoding="utf-8"):
    file = tmp_path / name
    file.write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
    return file


def frame(at, identifier, data=""):
    return can.Message(
        timestamp=at, arbitration_id=identifier, is_extended_id=False, data=bytes.fromhex(data)
    )


def texts(frames, file):
    return [each.text for each in Conversation(frames, Names(file)).events]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1", "cp1252", "utf-16"])
def test_every_encoding_of_eight_bits_is_read(tmp_path, encoding):
    found = read_data_sheet(sheet(tmp_path, SHEET, encoding=encoding))
    assert found.objects[0x2300, 0].name == "Spannung über Phase"
    assert (found.vendor, found.remarks) == (0x123, ())


def test_bytes_of_an_unknown_encoding_hurt_names_only(tmp_path):
    found = read_data_sheet(sheet(tmp_path, SHEET.encode("latin-1").replace(b"\xfc", b"\x81")))
    assert len(found.objects) == 12
    assert found.objects[0x2300, 0].name.isprintable()


@pytest.mark.parametrize("number", ["", "001", "none", "0x"])
def test_a_number_that_names_nobody_is_left_out_with_a_remark(tmp_path, number):
    text = SHEET.replace("VendorNumber=0x123", f"VendorNumber={number}")
    found = read_data_sheet(sheet(tmp_path, text))
    assert found.vendor is None
    assert found.remarks == (f"a.eds: not readable and left out: VendorNumber='{number}'",)
    assert len(found.objects) == 12


@pytest.mark.parametrize(
    ("good", "bad", "remark"),
    [
        ("FileName=a.eds", "FileName", "line 2: 'FileName'"),
        ("DefaultValue=0x23000020", "DefaultValue=0x2300OO20", "[1a00sub1] DefaultValue="),
        ("DefaultValue=$NODEID+0x280", "DefaultValue=$NODEID+$NODEID", "[1800sub1]"),
        ("DataType=0x15", "DataType=INTEGER64", "[2301] DataType='INTEGER64'"),
        ("ParameterName=Way\nDataType=0x15", "Way=1", "[2301]: it has no DataType"),
        ("[2302]", "[2301]", "[2301] comes again"),
        ("[FileInfo]\n", "stray\n[FileInfo]\n", "line 1: 'stray'"),
    ],
)
def test_what_is_at_fault_costs_itself_and_a_remark(tmp_path, good, bad, remark):
    assert good in SHEET
    found = read_data_sheet(sheet(tmp_path, SHEET.replace(good, bad)))
    assert len(found.objects) in {11, 12}
    assert found.objects[0x2400, 2].name == "Limits: Upper"
    (told,) = found.remarks
    assert remark in told


@pytest.mark.parametrize(
    "text",
    [
        SHEET.replace("$NODEID+0x280", "0x280+$NODEID"),
        SHEET.replace("$NODEID+0x280", "$nodeid + 0x280"),
        SHEET.replace("[1800sub1]", "[1800SUB1]").replace("[1A00sub1]", "[1a00Sub1]"),
        SHEET.replace("\n", "\r\n"),
        SHEET.replace("DataType=0x7\n", "DataType = 0x7 ; of 32 bits\n"),
        SHEET.replace("DataType=0x7\n", "DataType=0x7 # of 32 bits\n"),
        SHEET.replace("0x280", "0X280").replace("0x23000020", "587202592"),
        SHEET.replace("ParameterName", "parametername").replace("DefaultValue", "DEFAULTVALUE"),
    ],
)
def test_a_pdo_is_found_by_the_identifier_of_the_file(tmp_path, text):
    heard = [frame(0.0, 0x285, "0000c03f"), frame(0.1, 0x285, "000080bf")]
    told = Conversation(heard, Names(sheet(tmp_path, text)))
    assert summarise(told)["pdos"] == {
        "285h": {"node": 5, "name": "TPDO1", "entries": ["2300h Spannung über Phase"]}
    }
    signal = summarise(told)["nodes"]["5"]["signals"]["2300h Spannung über Phase"]
    assert signal == {"from": -1.0, "to": 1.5, "unit": ""}


def test_members_of_a_compact_array_have_their_names(tmp_path):
    found = read_data_sheet(sheet(tmp_path, SHEET))
    assert [found.objects[0x2400, sub].name for sub in range(4)] == [
        "Limits: number of entries",
        "Limits: Lower",
        "Limits: Upper",
        "Limits: 3",
    ]
    assert found.objects[0x2400, 2].type == "I16"


def test_members_of_a_compact_array_have_the_values_of_the_device(tmp_path):
    text = SHEET + "[2400Value]\nNrOfEntries=2\n1=5\n3=0x10\n"
    found = read_data_sheet(sheet(tmp_path, text, "a.dcf"))
    assert {key: value.number for key, value in found.values.items()} == {
        (0x2400, 1): 5,
        (0x2400, 3): 16,
    }


def test_a_record_with_a_type_of_its_own_is_its_entries(tmp_path):
    text = SHEET.replace("ParameterName=TPDO 1\n", "ParameterName=TPDO 1\nDataType=0x20\n")
    found = read_data_sheet(sheet(tmp_path, text))
    assert found.objects[0x1800, 0].type == "U8"
    assert found.objects[0x1800, 0].name == "TPDO 1: Number"
    assert not found.remarks


CONFIGURED = (
    SHEET.replace("DefaultValue=0x23000020", "DefaultValue=0x60410010\nParameterValue=0x23000020")
    .replace("$NODEID+0x280", "$NODEID+0x180\nParameterValue=0x3C5")
    .replace("[1000]", "[DeviceComissioning]\nNodeID=5\n[1000]")
)


def test_the_value_of_a_configured_device_is_its_own(tmp_path):
    heard = [frame(0.0, 0x3C5, "0000c03f"), frame(0.1, 0x187, "3702")]
    told = summarise(Conversation(heard, Names(sheet(tmp_path, CONFIGURED, "a.dcf"))))["pdos"]
    assert told["3C5h"] == {"node": 5, "name": "TPDO1", "entries": ["2300h Spannung über Phase"]}
    assert told["187h"]["entries"] == ["6041h Status word"]  # node 7 is none of that file


def test_the_identifier_of_a_node_that_the_file_does_not_name_is_its_alone(tmp_path):
    text = CONFIGURED.replace("NodeID=5", "").replace("0x3C5", "0x400003C5")
    found = read_data_sheet(sheet(tmp_path, text, "a.dcf"))  # 3C5h is of node 69
    assert found.held_by(69)[0x1800, 1] & 0x7FF == 0x3C5
    assert found.held_by(5)[0x1800, 1] == 0x185


def test_a_file_of_another_vendor_names_nothing(tmp_path):
    vendor = frame(0.0, 0x585, "43181001fb000000")
    ask = [frame(0.1, 0x605, "4000230000000000"), frame(0.2, 0x585, "430023000000c03f")]
    file = sheet(tmp_path, SHEET)
    assert texts(ask, file) == ["reads 2300h Spannung über Phase of node 5: 1.5"]
    assert texts([vendor, *ask], file)[-1].startswith("reads 2300h of node 5: 10")


@pytest.mark.parametrize("node", ["5", "05", "0x5", "0x05"])
def test_the_node_of_a_configured_device_is_read_in_every_form(tmp_path, node):
    text = CONFIGURED.replace("NodeID=5", f"NodeID={node}")
    assert read_data_sheet(sheet(tmp_path, text, "a.dcf")).node == 5


@pytest.mark.parametrize("content", ["", "<xml/>", "[FileInfo]\nFileName=a.eds\n", "[1000]\n"])
def test_a_file_without_objects_is_refused_in_one_line(tmp_path, content):
    with pytest.raises(LogError, match=r"a\.eds: not a readable EDS file"):
        Names(sheet(tmp_path, content))


def test_a_file_that_cannot_be_opened_is_told(tmp_path):
    with pytest.raises(LogError, match="cannot be read"):
        Names(tmp_path / "none.eds")


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be", "utf-32"])
def test_wide_letters_without_a_mark_are_read(tmp_path, encoding):
    (tmp_path / "a.eds").write_bytes(SHEET.encode(encoding))
    assert read_data_sheet(tmp_path / "a.eds").objects[0x2300, 0].name == "Spannung über Phase"


@pytest.mark.parametrize("vendor", ["-1", "0x100000000", "9" * 400])
def test_a_vendor_that_nobody_can_have_is_left_out(tmp_path, vendor):
    found = read_data_sheet(sheet(tmp_path, SHEET.replace("0x123", vendor)))
    assert found.vendor is None
    assert "VendorNumber" in found.remarks[0]


def test_of_a_broken_section_nothing_goes_to_the_one_before(tmp_path):
    text = SHEET.replace("[2301]\nParameterName", "[2301\nDefaultValue=7\nHighLimit")
    found = read_data_sheet(sheet(tmp_path, text.replace("[2300]", "[1A03sub1]")))
    assert (0x1A03, 1) not in found.defaults
    assert "'[2301'" in found.remarks[0]


def test_a_type_that_cannot_be_read_is_that_of_the_standard(tmp_path):
    text = SHEET + "\n[6064]\nParameterName=Place\nDataType=INTEGER32\n"
    heard = [can.Message(arbitration_id=0x581, data=bytes.fromhex("43646000FEFFFFFF"))]
    heard.insert(0, can.Message(arbitration_id=0x601, data=bytes.fromhex("4064600000000000")))
    for each in heard:
        each.is_extended_id = False
    told = Conversation(heard, Names(sheet(tmp_path, text)))
    assert told.events[0].text == "reads 6064h Place of node 1: -2"


def test_a_file_of_another_vendor_is_told(tmp_path):
    heard = [can.Message(arbitration_id=0x581, data=bytes.fromhex("43181001FB000000"))]
    heard.insert(0, can.Message(arbitration_id=0x601, data=bytes.fromhex("4018100100000000")))
    for each in heard:
        each.is_extended_id = False
    told = Conversation(heard, Names(sheet(tmp_path, SHEET)))
    assert list_remarks(told) == [
        "node 1: the EDS file is not used: it is of vendor 123h, the node of FBh"
    ]


@pytest.mark.parametrize(
    "spelt",
    [
        "$NODEID+280h", "$NODEID+280H", "($NODEID+0x280)", "0x280+$(NODEID)", "NODEID+0x280",
        "$Node_ID + 0x280", "Node-ID + 640", "$NODEID+0x280;cob", "$NODEID+0x280 // cob",
        "$NODEID+0x280 /* cob */", "$NODEID+0x280 (default)", '"$NODEID+0x280"', "$NODEID+0x280UL",
    ],
)  # fmt: skip
def test_numbers_are_read_as_editors_spell_them(tmp_path, spelt):
    found = read_data_sheet(sheet(tmp_path, SHEET.replace("$NODEID+0x280", spelt)))
    assert found.held_by(5)[0x1800, 1] == 0x285
    assert found.remarks == ()


@pytest.mark.parametrize("spelt", ["0x15;way", "0x15 // way", "15h", "21", '"0x15"', "0x15 (way)"])
def test_types_are_read_as_editors_spell_them(tmp_path, spelt):
    found = read_data_sheet(sheet(tmp_path, SHEET.replace("DataType=0x15", f"DataType={spelt}")))
    assert (found.objects[0x2301, 0].type, found.remarks) == ("I64", ())


@pytest.mark.parametrize(
    "name",
    ["1a00SUB1", "1A00 sub1", "1A00 Sub 1", " 1A00sub01 ", "0x1A00sub1", "1A00sub1] ; map ["],
)
def test_sections_are_found_as_editors_spell_them(tmp_path, name):
    found = read_data_sheet(sheet(tmp_path, SHEET.replace("[1A00sub1]", f"[{name}]")))
    assert found.objects[0x1A00, 1].name == "TPDO 1 mapping: Entry 1"
    assert found.held_by(5)[0x1A00, 1] == 0x2300_0020


def test_an_array_without_a_number_of_entries_may_follow_them(tmp_path):
    entries = (
        "[2500sub0]\nParameterName=Number\nDataType=5\n[2500sub1]\nParameterName=One\nDataType=3\n"
    )
    array = "[2500]\nParameterName=Row\nObjectType=0x8\nDataType=0x7\n"
    for text in (entries + array, array + entries):
        found = read_data_sheet(sheet(tmp_path, SHEET + text))
        number, one = found.objects[0x2500, 0], found.objects[0x2500, 1]
        assert (number.name, number.type) == ("Row: Number", "U8")
        assert (one.name, one.type) == ("Row: One", "I16")


def test_names_of_a_configured_array_count(tmp_path):
    found = read_data_sheet(
        sheet(tmp_path, f"{SHEET}[2400Denotation]\nNrOfEntries=1\n2=Soft end\n")
    )
    assert [found.objects[0x2400, k].name for k in (1, 2)] == ["Limits: Lower", "Limits: Soft end"]


def test_the_end_of_a_dos_file_is_no_line(tmp_path):
    assert read_data_sheet(sheet(tmp_path, SHEET + "\x1a")).remarks == ()


IDENTITY = "[1018sub1]\nParameterName=Vendor-ID\nDataType=7\nDefaultValue=0x9A\n"


def test_without_a_vendor_the_identity_object_names_it(tmp_path):
    file = sheet(tmp_path, SHEET.replace("VendorNumber=0x123\n", "") + IDENTITY)
    assert read_data_sheet(file).vendor == 0x9A
    assert read_data_sheet(sheet(tmp_path, SHEET + IDENTITY)).vendor == 0x123
    other = [frame(0.0, 0x601, "4018100100000000"), frame(0.1, 0x581, "431810016a000000")]
    asks = [frame(0.2, 0x601, "4001230000000000"), frame(0.3, 0x581, "4301230005000000")]
    file = sheet(tmp_path, SHEET.replace("VendorNumber=0x123\n", "") + IDENTITY)
    assert "Way" not in texts([*other, *asks], file)[-1]
    assert "Way" in texts(asks, file)[-1]
