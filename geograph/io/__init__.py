"""Readers and writers of recordings."""

from geograph.io.atomic import check_replaceable, replacing_folder
from geograph.io.convert import convert
from geograph.io.ecsv import read_ecsv
from geograph.io.reader import read
from geograph.io.writer import write

__all__ = ["check_replaceable", "convert", "read", "read_ecsv", "replacing_folder", "write"]
