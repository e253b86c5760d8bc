"""Between images and numbers: U-Nets, spatial softmax, Gaussian maps, encoder and decoder. Knows nothing of files."""

from keycld.vision.chunks import mean_in_chunks as mean_in_chunks
from keycld.vision.coordinates import gaussian_maps as gaussian_maps
from keycld.vision.coordinates import image_grid as image_grid
from keycld.vision.coordinates import pixel_size as pixel_size
from keycld.vision.coordinates import spatial_softmax as spatial_softmax
from keycld.vision.disc_fit import Discs as Discs
from keycld.vision.disc_fit import fit_discs as fit_discs
from keycld.vision.fully_connected import DenseEstimator as DenseEstimator
from keycld.vision.fully_connected import DenseRenderer as DenseRenderer
from keycld.vision.image_decoder import ImageDecoder as ImageDecoder
from keycld.vision.image_encoder import ImageEncoder as ImageEncoder
from keycld.vision.keypoint_estimator import AbstractEstimator as AbstractEstimator
from keycld.vision.keypoint_estimator import KeypointEstimator as KeypointEstimator
from keycld.vision.keypoint_estimator import Observation as Observation
from keycld.vision.keypoint_estimator import Standardise as Standardise
from keycld.vision.map_networks import MapEncoder as MapEncoder
from keycld.vision.map_networks import MapEnergy as MapEnergy
from keycld.vision.map_networks import MapTransform as MapTransform
from keycld.vision.moving_parts import Part as Part
from keycld.vision.moving_parts import moving_parts as moving_parts
from keycld.vision.renderer import AbstractRenderer as AbstractRenderer
from keycld.vision.renderer import Renderer as Renderer
from keycld.vision.still_background import still_background as still_background
from keycld.vision.unet import AbstractUNet as AbstractUNet
from keycld.vision.unet import LightUNet as LightUNet
from keycld.vision.unet import PaperUNet as PaperUNet

__all__ = [
    "AbstractEstimator",
    "AbstractRenderer",
    "AbstractUNet",
    "DenseEstimator",
    "DenseRenderer",
    "Discs",
    "ImageDecoder",
    "ImageEncoder",
    "KeypointEstimator",
    "LightUNet",
    "MapEncoder",
    "MapEnergy",
    "MapTransform",
    "Part",
    "Observation",
    "PaperUNet",
    "Renderer",
    "Standardise",
    "fit_discs",
    "gaussian_maps",
    "image_grid",
    "pixel_size",
    "mean_in_chunks",
    "moving_parts",
    "spatial_softmax",
    "still_background",
]
