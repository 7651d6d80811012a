//! Convolutions, with a kernel of our own where tensors lie on the processor.
//!
//! Burn's copies each neighbourhood into a row of a matrix (im2col) and multiplies with the crate
//! `gemm`, which reaches 30% of what a core with 512-bit vectors can do. [`direct`] reads the
//! padded planes in place, and its innermost loop holds its sums in registers. Elsewhere, and for
//! strides, dilations and groups, the convolution is Burn's.

mod direct;

use burn_core::tensor::module::conv2d;
use burn_core::tensor::ops::{ConvOptions, PadMode};
use burn_core::tensor::{DType, Device, Tensor};
use burn_nn::PaddingConfig2d;
use burn_nn::conv::Conv2d;
use direct::Filter;

pub use direct::Beyond;

/// `conv` of the channels of all `parts` `[n, c, h, w]`, one after the other.
pub fn convolve<const P: usize>(parts: [Tensor<4>; P], conv: &Conv2d) -> Tensor<4> {
    with(parts, conv, Beyond::Nothing)
}

/// `conv`, which is padded by half its kernel, of `x` `[n, c, h, w]` with its edges repeated
/// instead of zeros around it.
pub fn convolve_edges(x: Tensor<4>, conv: &Conv2d) -> Tensor<4> {
    with([x], conv, Beyond::Edges)
}

fn with<const P: usize>(parts: [Tensor<4>; P], conv: &Conv2d, beyond: Beyond) -> Tensor<4> {
    if is_for_kernel(&parts, conv) {
        on_processor(parts, conv, beyond)
    } else {
        by_burn(parts.to_vec(), conv, beyond)
    }
}

fn by_burn(mut parts: Vec<Tensor<4>>, conv: &Conv2d, beyond: Beyond) -> Tensor<4> {
    let x = match parts.pop() {
        Some(x) if parts.is_empty() => x,
        x => {
            parts.extend(x);
            Tensor::cat(parts, 1)
        }
    };
    if beyond == Beyond::Nothing {
        return conv.forward(x);
    }
    let [up, left] = conv.kernel_size.map(|k| k / 2);
    let x = x.pad([(0, 0), (0, 0), (up, up), (left, left)], PadMode::Edge);
    let options = ConvOptions::new(conv.stride, [0, 0], conv.dilation, conv.groups);
    conv2d(
        x,
        conv.weight.val(),
        conv.bias.as_ref().map(|bias| bias.val()),
        options,
    )
}

/// Whether the kernel does what `conv` does with `parts`.
fn is_for_kernel(parts: &[Tensor<4>], conv: &Conv2d) -> bool {
    let weight = conv.weight.val();
    let [_, channels, kh, kw] = weight.dims();
    let Some([n, _, h, w]) = parts.first().map(Tensor::dims) else {
        return false;
    };
    let half = PaddingConfig2d::Explicit(kh / 2, kw / 2, kh / 2, kw / 2);
    let plain = conv.stride == [1, 1] && conv.dilation == [1, 1] && conv.groups == 1;
    let n_channels: usize = parts.iter().map(|p| p.dims()[1]).sum();
    let fits = parts
        .iter()
        .all(|p| [0, 2, 3].map(|k| p.dims()[k]) == [n, h, w])
        && n_channels == channels;
    let centred = kh % 2 == 1 && kw % 2 == 1 && conv.padding == half;
    let bias = conv.bias.iter().map(|bias| bias.val().dtype());
    let mut types = parts
        .iter()
        .map(Tensor::dtype)
        .chain([weight.dtype()])
        .chain(bias);
    let here = weight.device() == Device::flex() && types.all(|t| t == DType::F32);
    here && plain && fits && centred && n * h * w * channels > 0
}

/// What is [for the kernel](is_for_kernel).
fn on_processor<const P: usize>(parts: [Tensor<4>; P], conv: &Conv2d, beyond: Beyond) -> Tensor<4> {
    let weight = conv.weight.val();
    let device = weight.device();
    let [out, channels, kh, kw] = weight.dims();
    let [n, _, h, w] = parts[0].dims();
    // borrowed, which cannot fail for 32 bits; else empty, which no filter is
    let weight = weight.into_data();
    let bias = conv.bias.as_ref().map(|bias| bias.val().into_data());
    let filter = Filter {
        weight: weight.as_slice().unwrap_or_default(),
        bias: bias.as_ref().and_then(|bias| bias.as_slice().ok()),
        out,
        channels,
        kernel: [kh, kw],
        beyond,
    };
    let parts = parts.map(Tensor::into_data);
    let planes = parts.each_ref().map(|p| p.as_slice().unwrap_or_default());
    let values = direct::convolve(&planes, n, [h, w], &filter);
    super::tensor(values, [n, out, h, w], &device)
}

#[cfg(test)]
mod tests {
    use super::{Beyond, by_burn, convolve, is_for_kernel, with};
    use crate::cpu;
    use crate::ops::{conv, tensor};
    use burn_core::module::Param;
    use burn_core::tensor::Tensor;
    use m4_testkit::{assert_close, formula_input};

    fn agrees<const P: usize>(
        parts: [usize; P],
        out: usize,
        kernel: [usize; 2],
        [n, h, w]: [usize; 3],
        bias: bool,
    ) {
        let device = cpu();
        let channels: usize = parts.iter().sum();
        let values = |key: &str, n: usize| formula_input(key, 0.1, 1.0, n);
        let mut layer = conv([channels, out], kernel[0], 1, bias, &device);
        let count = out * channels * kernel[0] * kernel[1];
        let scale = 1.0 / ((channels * kernel[0] * kernel[1]) as f32).sqrt();
        let weight = tensor(
            values("w", count),
            [out, channels, kernel[0], kernel[1]],
            &device,
        ) * scale;
        layer.weight = Param::from_tensor(weight);
        layer.kernel_size = kernel;
        let [py, px] = kernel.map(|k| k / 2);
        layer.padding = burn_nn::PaddingConfig2d::Explicit(py, px, py, px);
        layer.bias = bias.then(|| Param::from_tensor(tensor(values("b", out), [out], &device)));
        let parts: [Tensor<4>; P] = std::array::from_fn(|i| {
            let c = parts[i];
            tensor(
                values(&format!("x{i}"), n * c * h * w),
                [n, c, h, w],
                &device,
            )
        });
        let numbers = |x: Tensor<4>| -> Vec<f32> { x.try_into_vec_as().unwrap() };
        assert!(is_for_kernel(&parts, &layer));
        for beyond in [Beyond::Nothing, Beyond::Edges] {
            let got = numbers(with(parts.clone(), &layer, beyond));
            let want = numbers(by_burn(parts.to_vec(), &layer, beyond));
            assert_close(&format!("{out} {kernel:?}"), &got, &want, 3e-6);
        }
    }

    #[test]
    fn agrees_with_burn() {
        agrees([128, 64], 256, [3, 3], [2, 9, 13], true);
        agrees([5, 40, 1], 19, [3, 3], [3, 17, 30], false);
        agrees([4], 128, [7, 7], [1, 16, 24], true);
        agrees([196], 128, [1, 1], [2, 5, 7], true);
        agrees([33], 2, [3, 3], [1, 1, 1], true);
        agrees([24], 24, [1, 5], [1, 20, 33], true);
        agrees([24], 24, [5, 1], [1, 20, 33], true);
        agrees([3], 1, [3, 3], [1, 40, 200], false);
    }

    #[test]
    fn a_stride_is_not_for_the_kernel() {
        let device = cpu();
        let layer = conv([4, 4], 3, 2, true, &device);
        assert!(!is_for_kernel(
            &[Tensor::zeros([1, 4, 8, 8], &device)],
            &layer
        ));
        assert_eq!(
            convolve([Tensor::zeros([1, 4, 8, 8], &device)], &layer).dims(),
            [1, 4, 4, 4]
        );
    }
}
