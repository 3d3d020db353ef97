"""Sums over samples on the nodes that they are spread to: each node gathers its own, so no two write to one place."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag


@dataclass(frozen=True, eq=False)
class Bags:
    """A sparse matrix from samples to nodes, one bag of samples a node.

    sample  (K,) int32, those of the first node first
    share   (K,) float32: of each in its node
    ends    (nodes + 1,) int32: where the bags begin, and the end
    """

    sample: Tensor
    share: Tensor
    ends: Tensor

    @classmethod
    def of(cls, node: Tensor, share: Tensor, nodes: int) -> "Bags":
        """Of samples that are spread to k nodes each: node (N, k) int32, share (N, k) float32."""
        order = node.ravel().argsort(stable=True)
        ends = torch.zeros(nodes + 1, dtype=torch.int32)
        ends[1:] = torch.bincount(node.ravel(), minlength=nodes).cumsum(0)
        return cls((order // node.shape[1]).int(), share.ravel()[order], ends)

    def sums(self, values: Tensor) -> Tensor:
        """(nodes, C) of values (N, C) float32."""
        return embedding_bag(
            self.sample, values, self.ends, mode="sum", per_sample_weights=self.share, include_last_offset=True
        )
