"""What the generator of training data says of metals: the priors of yesnt/decompose/evidence/settings.py.

python tests/benchmarks/evidence_prior.py
"""

import numpy as np
from scipy.optimize import minimize
from scipy.stats import beta

from yesnt.core.color import luminance
from yesnt.training.synthetic.dataset import draw_image
from yesnt.training.synthetic.materials import draw_class, paint

EDGES = np.array([0, 0.125, 0.375, 0.625, 0.875, 1])
"""Cells of the levels of metallic."""


def main():
    rng = np.random.default_rng(0)
    images = [draw_image(rng, 64) for _ in range(150)]
    metallic = np.concatenate([image.truth[1][image.matte > 0.99] for image in images])
    share = np.histogram(metallic, EDGES)[0] / len(metallic)

    def misfit(logs):
        return -(share * np.log(np.maximum(np.diff(beta.cdf(EDGES, *np.exp(logs))), 1e-12))).sum()

    fitted = np.exp(minimize(misfit, np.log([0.1, 0.25]), method="Nelder-Mead").x)
    print(f"metallic of {len(metallic)} pixels by cell: {share.round(4)}; Beta {fitted.round(4)}")
    materials = [paint(rng, draw_class(rng)) for _ in range(8000)]
    metals = np.log([luminance(np.asarray(m["base"], float)) for m in materials if m["metallic"] > 0])
    print(f"base colour of metals: median luminance {np.exp(np.median(metals)):.2f}, "
          f"standard deviation of its logarithm {metals.std():.2f}")  # fmt: skip


if __name__ == "__main__":
    main()
