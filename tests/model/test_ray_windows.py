import pytest
import torch
from attention_inputs import attend_loop

from rfpp.model.layers.attention import AttentionPattern, attend
from rfpp.model.layers.ray_windows import ShiftedWindows, WholeView
from rfpp.segments import Segments

CPU = torch.device("cpu")


def sees(pattern: AttentionPattern) -> torch.Tensor:
    """[n, n] bool, in the order of the rows."""
    order = torch.arange(pattern.queries.total) if pattern.order is None else pattern.order
    segment = torch.empty_like(order)
    segment[order] = pattern.queries.index
    return segment[:, None] == segment


def test_a_whole_view_is_seen_by_itself_alone():
    (pattern,) = WholeView()(2, 2, 3, CPU)
    assert torch.equal(sees(pattern), torch.block_diag(torch.ones(6, 6), torch.ones(6, 6)).bool())


@pytest.mark.parametrize("rows", [8, 10])
def test_windows_are_squares_of_the_grid_and_shifted_in_every_second_layer(rows):
    columns = 9
    for pattern, edges in zip(ShiftedWindows(4)(2, rows, columns, CPU), ((4, 8), (2, 6)), strict=True):
        view, row, column = (
            i.ravel() for i in torch.meshgrid(torch.arange(2), torch.arange(rows), torch.arange(columns), indexing="ij")
        )
        edges = torch.tensor([*edges, 10]) if edges[0] == 2 else torch.tensor(edges)
        window = torch.stack(
            [view, torch.bucketize(row, edges, right=True), torch.bucketize(column, edges, right=True)]
        )
        assert torch.equal(sees(pattern), (window[:, :, None] == window[:, None]).all(0))


def test_attention_in_another_order_of_the_rows_has_the_same_values_and_gradients():
    torch.manual_seed(0)
    order = torch.randperm(20)
    segments = Segments.from_lengths([5, 12, 3])
    q, k, v = (torch.randn(20, 2, 4, dtype=torch.double, requires_grad=True) for _ in range(3))
    out = attend(q, k, v, AttentionPattern(segments, order=order))
    expected = torch.empty_like(out)
    expected[order] = attend_loop(q[order], k[order], v[order], AttentionPattern(segments))
    torch.testing.assert_close(out, expected)
    weights = torch.randn_like(out)
    gradients = [torch.autograd.grad((x * weights).sum(), (q, k, v), retain_graph=True) for x in (out, expected)]
    for ours, theirs in zip(*gradients, strict=True):
        torch.testing.assert_close(ours, theirs)
    with pytest.raises(ValueError, match="self-attention"):
        AttentionPattern(segments, segments, order=order)
