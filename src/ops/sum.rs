//! The sum of a tensor in a fixed order.

use burn::tensor::Tensor;

/// Values that are summed at a time.
const BLOCK: usize = 1024;

/// The sum `[1]` of all values of `x`. It has the same bits each time, unlike burn's own sum, which adds with atomics on a GPU.
pub fn sum_all<const D: usize>(x: Tensor<D>) -> Tensor<1> {
    let count = x.shape().num_elements();
    if count == 0 {
        return x.sum();
    }
    let sum_row = |x: Tensor<1>| {
        let length = x.dims()[0];
        x.reshape([1, length]).sum_dim(1).reshape([1])
    };
    let x = x.reshape([count]);
    let stretches = count / BLOCK;
    let rest = count % BLOCK;
    if stretches == 0 {
        return sum_row(x);
    }
    let whole = x.clone().narrow(0, 0, stretches * BLOCK);
    let parts = whole.reshape([stretches, BLOCK]).sum_dim(1);
    let sum = sum_row(parts.reshape([stretches]));
    if rest == 0 {
        return sum;
    }
    sum + sum_row(x.narrow(0, stretches * BLOCK, rest))
}
