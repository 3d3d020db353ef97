"""Which priors of the estimator a photograph is weighed by, and which explains it best."""

import torch
from torch import Tensor

from torchbrdf.estimation import UnformedSpace
from torchbrdf.estimation.priors import Explanation, PriorBank, prior_variances, whole_variances

_PROMISING, _OUTLINED = 6, 48
"""Priors whose evidence is told exactly, those of highest evidence in so many directions: what the others add to it is
below a thousandth (docs/alignment.md)."""


def priors_of(norms: Tensor, space: UnformedSpace, whole: bool) -> Tensor:
    """Variances (M, n) of all priors without classes, of basis BRDFs of norms (n,); or of the whole library only."""
    if whole:
        variances = whole_variances(norms)[None]
        return variances / variances.mean()
    return prior_variances(torch.zeros(0, len(norms), dtype=torch.bool, device=norms.device), norms, space)


def promising(space: UnformedSpace, variances: Tensor, y: Tensor) -> Tensor:
    """Which of the priors (M, n) may explain a photograph (1, 3, P) best."""
    if len(variances) <= _PROMISING:
        return torch.arange(len(variances), device=variances.device)
    found = PriorBank.of(space.first(_OUTLINED), variances, correlation=1).explain(y)
    return found.log_evidence[0].amax(-1).topk(_PROMISING).indices.sort().values


def likeliest(explanation: Explanation) -> tuple[int, int, Tensor]:
    """The prior and the penalty of the highest evidence, and the weights (3, n) at the top of their posterior."""
    evidence = explanation.log_evidence
    m, penalty = divmod(int(evidence[0].argmax()), evidence.shape[2])
    only = torch.zeros_like(evidence)
    only[0, m, penalty] = 1
    return m, penalty, explanation.components(only)[0, m]


def pixels_per_misfit(explanation: Explanation, m: int, penalty: int, doubt: float) -> Tensor:
    """(3,): independent pixels over the misfit y^T M^-1 y of each channel, with a prior and a penalty; 0 where it is 0.

    doubt  what the evidence is divided by
    """
    misfit = explanation.quadratic[0, m, :, penalty]
    return torch.where(misfit > 0, explanation.bank.independent_pixels / doubt / misfit, 0)
