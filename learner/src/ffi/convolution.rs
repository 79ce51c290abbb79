//! Convolutions: the gradient that tch leaves out (`convolution.cpp`), and the CPU's own (`patches.cpp`).

use super::guarded;
use std::ffi::{c_char, c_int};
use tch::{TchError, Tensor};
use torch_sys::C_tensor;

unsafe extern "C" {
    fn stillroom_convolution(
        x: *const C_tensor,
        weight: *const C_tensor,
        bias: *const C_tensor,
        stride: i64,
        padding: i64,
        y: *mut *mut C_tensor,
        message: *mut c_char,
        capacity: usize,
    ) -> c_int;
    fn stillroom_convolution_backward(
        dy: *const C_tensor,
        x: *const C_tensor,
        weight: *const C_tensor,
        stride: i64,
        padding: i64,
        wants_dx: bool,
        dx: *mut *mut C_tensor,
        dw: *mut *mut C_tensor,
        message: *mut c_char,
        capacity: usize,
    ) -> c_int;
}

/// `x.conv2d(weight, bias)` of 32-bit maps on the CPU, with the same bits on every processor and for any number of
/// threads, gradients included. Square strides and paddings, one group. The result has its channels last in memory.
pub fn convolution(
    x: &Tensor,
    weight: &Tensor,
    bias: Option<&Tensor>,
    [stride, padding]: [i64; 2],
) -> Result<Tensor, TchError> {
    let mut y = std::ptr::null_mut();
    let bias = bias.map_or(std::ptr::null(), Tensor::as_ptr);
    guarded(|message, capacity| {
        // SAFETY: the tensors live through the call, the out-pointer and the message's room are ours.
        unsafe {
            stillroom_convolution(x.as_ptr(), weight.as_ptr(), bias, stride, padding, &raw mut y, message, capacity)
        }
    })?;
    // SAFETY: allocated by `new` for us; tch frees it.
    unsafe { Ok(Tensor::from_ptr(y)) }
}

/// Gradients of `x.conv2d(weight)` for `dy`, the gradient of its output: of the weight, and of `x` where it is wanted.
/// Square strides and paddings, no bias, one group. Tensors may be in any memory format and of any floating kind.
pub fn convolution_backward(
    dy: &Tensor,
    x: &Tensor,
    weight: &Tensor,
    [stride, padding]: [i64; 2],
    wants_dx: bool,
) -> Result<(Tensor, Option<Tensor>), TchError> {
    let (mut dx, mut dw) = (std::ptr::null_mut(), std::ptr::null_mut());
    guarded(|message, capacity| {
        // SAFETY: the three tensors live through the call, the out-pointers and the message's room are ours.
        unsafe {
            stillroom_convolution_backward(
                dy.as_ptr(),
                x.as_ptr(),
                weight.as_ptr(),
                stride,
                padding,
                wants_dx,
                &raw mut dx,
                &raw mut dw,
                message,
                capacity,
            )
        }
    })?;
    // SAFETY: both were allocated by `new` for us; tch frees them.
    unsafe { Ok((Tensor::from_ptr(dw), (!dx.is_null()).then(|| Tensor::from_ptr(dx)))) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tch::{Device, Kind};

    #[test]
    fn it_is_what_autograd_says() {
        tch::manual_seed(3);
        let float = (Kind::Float, Device::Cpu);
        for (size, stride, padding) in [(3, 1, 1), (3, 2, 1), (1, 2, 0), (4, 1, 0)] {
            let x = Tensor::randn([2, 4, 9, 9], float).set_requires_grad(true);
            let weight = Tensor::randn([6, 4, size, size], float).set_requires_grad(true);
            let y = x.conv2d(&weight, None::<Tensor>, [stride; 2], [padding; 2], [1; 2], 1);
            let dy = y.randn_like();
            let expected = Tensor::run_backward(&[(&y * &dy).sum(Kind::Float)], &[&x, &weight], false, false);
            let (x, weight) = (x.detach(), weight.detach());
            let (dw, dx) = convolution_backward(&dy, &x, &weight, [stride, padding], true).unwrap();
            assert!(dx.unwrap().allclose(&expected[0], 1e-5, 1e-5, false));
            assert!(dw.allclose(&expected[1], 1e-5, 1e-5, false));
            assert!(convolution_backward(&dy, &x, &weight, [stride, padding], false).unwrap().1.is_none());
        }
    }

    /// Values and all gradients against libtorch's in double, with strides, paddings and sizes of both encoders.
    #[test]
    fn the_cpus_own_is_libtorchs() {
        tch::manual_seed(5);
        let float = (Kind::Float, Device::Cpu);
        for (images, channels, outputs, side, size, stride, padding) in [
            (3, 1, 32, 56, 8, 4, 0),
            (5, 32, 64, 13, 4, 2, 0),
            (300, 64, 32, 5, 3, 1, 0),
            (2, 1, 8, 20, 7, 2, 3),
            (2, 5, 7, 9, 3, 2, 1),
            (1, 4, 6, 6, 1, 2, 0),
        ] {
            let x = Tensor::randn([images, channels, side, side], float);
            let weight = Tensor::randn([outputs, channels, size, size], float);
            let bias = Tensor::randn([outputs], float);
            let run = |kind: Kind, own: bool| {
                let inputs = [&x, &weight, &bias].map(|t| t.to_kind(kind).copy().set_requires_grad(true));
                let [x, weight, bias] = &inputs;
                let y = if own {
                    convolution(x, weight, Some(bias), [stride, padding]).unwrap()
                } else {
                    x.conv2d(weight, Some(bias), [stride; 2], [padding; 2], [1; 2], 1)
                };
                let loss = (&y * (&y * 0.5 + 1.0)).sum(kind);
                let mut results = Tensor::run_backward(&[loss], &inputs, false, false);
                results.push(y.detach());
                results
            };
            let expected = run(Kind::Double, false);
            for threads in [1, 2, 3] {
                tch::set_num_threads(threads);
                for (own, expected) in run(Kind::Float, true).iter().zip(&expected) {
                    let expected = expected.to_kind(Kind::Float);
                    let scale = f64::try_from(expected.abs().max()).unwrap();
                    assert!(own.allclose(&expected, 1e-5, 1e-5 * scale, false), "{size} {stride} {padding}");
                }
            }
            let bits = |threads| {
                tch::set_num_threads(threads);
                run(Kind::Float, true).iter().map(crate::network::to_vec).collect::<Vec<_>>()
            };
            assert_eq!(bits(1), bits(3));
            assert!(convolution(&x, &weight, None, [stride, padding]).is_ok());
        }
    }

    #[test]
    fn shapes_that_do_not_fit_are_an_error() {
        let x = Tensor::zeros([1, 2, 5, 5], (Kind::Float, Device::Cpu));
        let weight = Tensor::zeros([3, 2, 3, 3], (Kind::Float, Device::Cpu));
        assert!(convolution_backward(&x, &x, &weight, [1, 1], true).is_err());
        let weight = Tensor::zeros([3, 4, 3, 3], (Kind::Float, Device::Cpu));
        assert!(convolution(&x, &weight, None, [1, 0]).is_err());
    }
}
