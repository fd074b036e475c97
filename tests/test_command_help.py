"""Help of the commands: settings with their comments, chosen files, and the choices of groups."""

from rfpp.command_help import help_text
from rfpp.commands import CONFIG_DIR


def test_help_holds_settings_with_comments_and_choices():
    said = help_text("Train.", "train", CONFIG_DIR)
    assert said.startswith("Train.")
    assert "steps: 1000                   # optimizer steps" in said
    assert "checkpoint: auto " in said
    assert "  optimizer=                adamw" in said
    assert "datamodule/reader=        indexed, webdataset" in said
    assert "paper/without_pitg" in said
    assert "\nhydra:" not in said and "defaults:" not in said
    assert len(said.splitlines()) < 80


def test_help_shows_the_chosen_files():
    quickstart = "log_every_n_steps"
    assert quickstart not in help_text("Train.", "train", CONFIG_DIR)
    assert quickstart in help_text("Train.", "train", CONFIG_DIR, ["experiment=quickstart", "--help"])


def test_help_of_a_command_without_groups_ends_with_its_settings():
    assert "Groups" not in help_text("View.", "view", CONFIG_DIR)
