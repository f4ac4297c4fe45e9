"""Every item of the list of errata in docs/theory.md has a test of its number."""

import re
from pathlib import Path

HERE = Path(__file__).parent


def test_every_item_of_the_list_has_a_test():
    page = (HERE.parents[1] / "docs" / "theory.md").read_text(encoding="utf-8")
    items = re.findall(r"^(\d+)\. ", page.split("## 13. The paper's printed forms")[1], re.M)
    tests = "".join(file.read_text(encoding="utf-8") for file in HERE.glob("test_*errata*.py"))
    assert items == [str(number) for number in range(1, 14)]
    assert set(items) <= set(re.findall(r"def test_(?:item|note)_(\d+)_", tests))
