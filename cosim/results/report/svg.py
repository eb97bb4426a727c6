"""What drawings in SVG begin with, are lettered with and end as."""

from __future__ import annotations

import xml.etree.ElementTree as ET


def begin_drawing(name: str, width: float, height: float, style: str) -> ET.Element:
    """Return the root of a drawing [px] with its title and its style sheet."""
    root = ET.Element("svg", xmlns="http://www.w3.org/2000/svg", viewBox=f"0 0 {width:g} {height:g}", role="img")
    ET.SubElement(root, "title").text = name
    ET.SubElement(root, "style").text = style
    return root


def text(root: ET.Element, x: float, y: float, words: str, kind: str, anchor: str = "start") -> None:
    """Add a text at a position [px], of a class of the style sheet."""
    ET.SubElement(root, "text", {"class": kind, "x": f"{x:g}", "y": f"{y:g}", "text-anchor": anchor}).text = words


def finish_drawing(root: ET.Element) -> str:
    """Return the document as text."""
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
