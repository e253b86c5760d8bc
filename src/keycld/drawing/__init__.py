"""Arrays → PNG, GIF and MP4. No physics: only pixels, curves and colours."""

from keycld.drawing.curves import Curve as Curve
from keycld.drawing.curves import Limit as Limit
from keycld.drawing.curves import curves_figure as curves_figure
from keycld.drawing.curves import figure_svg as figure_svg
from keycld.drawing.curves import histogram_figure as histogram_figure
from keycld.drawing.curves import map_figure as map_figure
from keycld.drawing.curves import panels_figure as panels_figure
from keycld.drawing.curves import strip_figure as strip_figure
from keycld.drawing.files import load_image as load_image
from keycld.drawing.files import save_figure as save_figure
from keycld.drawing.files import save_image as save_image
from keycld.drawing.files import save_movie as save_movie
from keycld.drawing.frames import as_uint8 as as_uint8
from keycld.drawing.frames import enlarge as enlarge
from keycld.drawing.frames import labelled_sheet as labelled_sheet
from keycld.drawing.frames import sheet as sheet
from keycld.drawing.frames import side_by_side as side_by_side
from keycld.drawing.overlays import overlay_future as overlay_future
from keycld.drawing.overlays import overlay_heat_maps as overlay_heat_maps
from keycld.drawing.overlays import overlay_keypoints as overlay_keypoints
from keycld.drawing.overlays import overlay_timeline as overlay_timeline
from keycld.drawing.overlays import to_pixels as to_pixels
from keycld.drawing.palette import INK as INK
from keycld.drawing.palette import KEYPOINT_COLOURS as KEYPOINT_COLOURS
from keycld.drawing.palette import Ink as Ink
from keycld.drawing.skeletons import overlay_links as overlay_links
from keycld.drawing.skeletons import overlay_paths as overlay_paths

__all__ = [
    "INK",
    "KEYPOINT_COLOURS",
    "Curve",
    "Ink",
    "Limit",
    "as_uint8",
    "curves_figure",
    "enlarge",
    "figure_svg",
    "histogram_figure",
    "labelled_sheet",
    "map_figure",
    "overlay_future",
    "overlay_heat_maps",
    "overlay_keypoints",
    "overlay_links",
    "overlay_paths",
    "overlay_timeline",
    "panels_figure",
    "save_figure",
    "save_image",
    "save_movie",
    "sheet",
    "side_by_side",
    "strip_figure",
    "to_pixels",
]
