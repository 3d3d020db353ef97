"""What one solve found, for photographs that share the pixels used."""

from dataclasses import dataclass

from torch import Tensor

from torchbrdf.estimation.priors import Explanation


@dataclass(frozen=True, eq=False)
class Solution:
    """Of B photographs: weights (B, n, 3) and class candidates (B, K, n, 3).

    fitted (B, 3, P) shows the weights; errors (B, 1 + K) of them and of the candidates over the pixels used
    probabilities (B, K); optimality (B, 3) of a constraint; evidence: what a posterior is made from
    """

    weights: Tensor
    class_weights: Tensor
    fitted: Tensor
    errors: Tensor
    probabilities: Tensor
    optimality: Tensor
    evidence: Explanation | None = None
