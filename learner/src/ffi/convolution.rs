//! The gradient of a convolution, which tch leaves out (`convolution.cpp`).

use super::guarded;
use std::ffi::{c_char, c_int};
use tch::{TchError, Tensor};
use torch_sys::C_tensor;

unsafe extern "C" {
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

    #[test]
    fn shapes_that_do_not_fit_are_an_error() {
        let x = Tensor::zeros([1, 2, 5, 5], (Kind::Float, Device::Cpu));
        let weight = Tensor::zeros([3, 2, 3, 3], (Kind::Float, Device::Cpu));
        assert!(convolution_backward(&x, &x, &weight, [1, 1], true).is_err());
    }
}
