"""All priors side by side: S of w ~ N(a mu, tau^2 diag(S))."""

import torch
from torch import Tensor

from torchbrdf.estimation.image_space import ImageSpace
from torchbrdf.estimation.priors.neighbourhoods import neighbourhood_variances
from torchbrdf.estimation.priors.whole_library import whole_variances


def prior_variances(membership: Tensor, norms: Tensor, space: ImageSpace) -> Tensor:
    """S (M, n) of all priors, each of mean 1: the K classes, the whole library, then neighbourhoods.

    membership  (K, n) bool  the basis BRDFs of every class
    norms       (n,)         |b_i|
    """
    whole = whole_variances(norms)
    variances = torch.cat([membership.to(whole), whole[None], neighbourhood_variances(space, whole)])
    return variances / variances.mean(1, keepdim=True)
