"""Connected components, of keypoints that matches join and of views that pairs join."""

from __future__ import annotations

from typing import Dict, Hashable, List, Sequence, Tuple, TypeVar

import numpy as np

Node = TypeVar("Node", bound=Hashable)


def components(nodes: Sequence[Node], edges: Sequence[Tuple[Node, Node]]) -> List[List[Node]]:
    """The groups of nodes that edges connect; groups and their members in the order of ``nodes``."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    number = {node: k for k, node in enumerate(nodes)}
    ends = np.array([(number[a], number[b]) for a, b in edges], dtype=np.intp).reshape(-1, 2)
    graph = coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), (len(number), len(number)))
    groups: Dict[int, List[Node]] = {}
    for node, label in zip(number, connected_components(graph, directed=False)[1]):
        groups.setdefault(int(label), []).append(node)
    return list(groups.values())
