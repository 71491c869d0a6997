from twin.markdown import table


def test_a_table_has_words_to_the_left_numbers_to_the_right_and_an_empty_line_after_it():
    text = table(("name", "a", "remark"), [("x", "1", "good"), ("y", "2", "")], words=(0, -1))
    assert text.splitlines() == [
        "| name | a | remark |",
        "|---|--:|---|",
        "| x | 1 | good |",
        "| y | 2 |  |",
    ]
    assert "\n".join([text, "next"]).endswith("|\n\nnext")


def test_by_default_only_the_first_column_holds_words():
    assert table(("a", "b", "c"), []) == "| a | b | c |\n|---|--:|--:|\n"
