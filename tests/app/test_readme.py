"""The code in README runs as printed."""

import re
from pathlib import Path

README = (Path(__file__).parents[2] / "README.md").read_text()


def test_the_python_example_runs(capsys):
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    exec(compile(code, "README.md", "exec"), {})
    assert capsys.readouterr().out


def test_files_it_names_are_there():
    root = Path(__file__).parents[2]
    for name in re.findall(r"`(\w+\.toml)`", README):
        assert (root / "problems" / name).is_file(), name
    for link in re.findall(r"\]\(([\w/.]+)\)", README):
        assert (root / link).exists(), link
