"""Write the README's picture from evaluated runs: python scripts/readme_picture.py RUN [RUN ...].

Every sixth frame of each run's first test recording, with the prediction below.
"""

import sys

from keycld.drawing import enlarge, save_image, sheet
from keycld.evaluation import load_evaluation

rows = []
for run in sys.argv[1:]:
    arrays = load_evaluation(run, "test@50").arrays
    rows += [arrays["truth"][0], arrays["prediction"][0]]
save_image("docs/media/prediction.png", enlarge(sheet(rows), 2))
