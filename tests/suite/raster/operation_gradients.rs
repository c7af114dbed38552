//! Gradients of the differentiable operation against finite differences in f64, and against the slices.

use crate::support::finite_differences::{Loss, SMOOTH, check, differences, gradients};
use crate::support::raster_reference::{camera, cloud, numbers};
use burn::tensor::{DType, Tensor, TensorData};
use coseg::raster::{Projected, RasterInput, Settings, rasterize};

/// Tensors of one scene on the f64 autodiff device, in the order means, log_scales, rotations, logits, sh, features.
struct Leaves([Vec<f64>; 6], usize);

impl Leaves {
    fn tensors(&self, device: &burn::tensor::Device) -> RasterInput {
        let n = self.0[3].len();
        let data = |i: usize, shape: Vec<usize>| TensorData::new(self.0[i].clone(), shape);
        let two =
            |i, w| Tensor::<2>::from_data(data(i, vec![n, w]), (device, DType::F64)).require_grad();
        RasterInput {
            means: two(0, 3),
            log_scales: two(1, 3),
            rotations: two(2, 4),
            opacity_logits: Tensor::<1>::from_data(data(3, vec![n]), (device, DType::F64))
                .require_grad(),
            sh: (!self.0[4].is_empty()).then(|| {
                let terms = self.0[4].len() / n / 3;
                Tensor::<3>::from_data(data(4, vec![n, terms, 3]), (device, DType::F64))
                    .require_grad()
            }),
            active_sh_degree: self.1,
            features: (!self.0[5].is_empty()).then(|| two(5, self.0[5].len() / n)),
            screen: Some(Tensor::<2>::zeros([n, 2], (device, DType::F64)).require_grad()),
        }
    }
}

fn values_of<const D: usize>(t: Tensor<D>) -> Vec<f64> {
    t.into_data().into_vec().expect("f64")
}

#[test]
fn gradients_of_the_operation_equal_finite_differences() {
    let device = crate::support::device().autodiff();
    let camera = camera(19, 17);
    let c = cloud(8, 0.08, &camera, 9);
    let n = c.len();
    let background = [0.3, 0.9, -0.4];
    for (degree, active, features) in [(3, 3, 2), (2, 1, 0), (0, 0, 6)] {
        let terms = (degree + 1) * (degree + 1);
        // Some colours fall below 0 and are cut off there; none lies near the edge with these seeds.
        let sh = numbers(n * terms * 3, 21);
        let leaves = Leaves(
            [
                c.means.clone(),
                c.log_scales.clone(),
                c.rotations.clone(),
                c.opacity_logits.clone(),
                sh,
                numbers(n * features, 22),
            ],
            active,
        );
        let channels = 3 + features;
        let loss = Loss::new(&camera, channels);
        let shape = [camera.height, camera.width, channels];
        let tensor = |v: &[f64], d: &burn::tensor::Device| {
            Tensor::<3>::from_data(TensorData::new(v.to_vec(), shape), (d, DType::F64))
        };
        let value = |leaves: &Leaves| {
            let input = leaves.tensors(&device);
            let out = rasterize(input.clone(), &camera, &SMOOTH, background).expect("valid");
            let t = TensorData::new(loss.transmittance.clone(), [camera.height, camera.width]);
            let t = Tensor::<2>::from_data(t, (&device, DType::F64));
            let sum =
                (out.image * tensor(&loss.image, &device)).sum() + (out.transmittance * t).sum();
            (input, sum)
        };
        let (input, sum) = value(&leaves);
        let grads = sum.backward();
        macro_rules! grad {
            ($t:expr) => {
                values_of($t.grad(&grads).expect("tracked"))
            };
        }
        let got = [
            grad!(input.means),
            grad!(input.log_scales),
            grad!(input.rotations),
            grad!(input.opacity_logits),
            grad!(input.sh.expect("given")),
            input.features.map_or_else(Vec::new, |f| grad!(f)),
        ];
        let names = [
            "means",
            "log_scales",
            "rotations",
            "opacity_logits",
            "sh",
            "features",
        ];
        for (i, name) in names.into_iter().enumerate() {
            if leaves.0[i].is_empty() {
                continue;
            }
            let numeric = differences(&leaves.0[i], 1e-4, |x| {
                let mut moved = Leaves(leaves.0.clone(), leaves.1);
                moved.0[i].copy_from_slice(x);
                value(&moved).1.into_scalar::<f64>()
            });
            check(
                &format!("operation, degree {degree}, {name}"),
                &got[i],
                &numeric,
            );
        }
        let screen = grad!(input.screen.expect("given"));
        assert_eq!(screen.len(), 2 * n);
        assert!(screen.iter().any(|&v| v != 0.0));
    }
}

#[test]
fn the_operation_equals_the_slices() {
    let device = crate::support::device().autodiff();
    let camera = camera(40, 31);
    let c = cloud(60, 0.04, &camera, 12);
    let n = c.len();
    let zeros = |values: &[f64]| vec![0.0; values.len()];
    for features in [1, 3, 6, 20] {
        let values = numbers(n * features, 4);
        let both = Loss::new(&camera, features);
        let leaves = Leaves(
            [
                c.means.clone(),
                c.log_scales.clone(),
                c.rotations.clone(),
                c.opacity_logits.clone(),
                Vec::new(),
                values.clone(),
            ],
            0,
        );
        let of_image = Loss {
            transmittance: zeros(&both.transmittance),
            image: both.image.clone(),
        };
        let of_transmittance = Loss {
            image: zeros(&both.image),
            transmittance: both.transmittance.clone(),
        };
        let mut apart = Vec::new();
        for (loss, on_image) in [(of_image, true), (of_transmittance, false)] {
            let want = gradients(&c, &values, features, &camera, &Settings::default(), &loss);
            let input = leaves.tensors(&device);
            let out =
                rasterize(input.clone(), &camera, &Settings::default(), [0.5; 3]).expect("valid");
            let projected =
                Projected::new(&c.splats(), &camera, &Settings::default()).expect("valid");
            let blended = projected.blend(&values, features);
            let radii = projected.radii().iter().map(|&radius| f64::from(radius));
            assert_eq!(values_of(out.radii.clone()), radii.collect::<Vec<f64>>());
            assert_eq!(values_of(out.image.clone()), blended.image);
            assert_eq!(values_of(out.transmittance.clone()), blended.transmittance);
            let data = |v: &[f64], shape: Vec<usize>| TensorData::new(v.to_vec(), shape);
            let sum = if on_image {
                let weights = data(&loss.image, vec![camera.height, camera.width, features]);
                (out.image * Tensor::<3>::from_data(weights, (&device, DType::F64))).sum()
            } else {
                let weights = data(&loss.transmittance, vec![camera.height, camera.width]);
                (out.transmittance * Tensor::<2>::from_data(weights, (&device, DType::F64))).sum()
            };
            let grads = sum.backward();
            macro_rules! grad {
                ($t:expr) => {
                    values_of($t.grad(&grads).expect("tracked"))
                };
            }
            assert_eq!(grad!(input.means), want.means);
            assert_eq!(grad!(input.log_scales), want.log_scales);
            assert_eq!(grad!(input.rotations), want.rotations);
            assert_eq!(grad!(input.opacity_logits), want.opacity_logits);
            assert_eq!(grad!(input.features.expect("given")), want.values);
            assert_eq!(grad!(input.screen.expect("given")), want.screen);
            apart.push(want.means);
        }
        // The gradient of a loss on both is the sum of the two.
        let input = leaves.tensors(&device);
        let out = rasterize(input.clone(), &camera, &Settings::default(), [0.5; 3]).expect("valid");
        let weights = TensorData::new(both.image, [camera.height, camera.width, features]);
        let image = out.image * Tensor::<3>::from_data(weights, (&device, DType::F64));
        let weights = TensorData::new(both.transmittance, [camera.height, camera.width]);
        let t = out.transmittance * Tensor::<2>::from_data(weights, (&device, DType::F64));
        let grads = (image.sum() + t.sum()).backward();
        let sum = apart[0].iter().zip(&apart[1]).map(|(a, b)| a + b);
        assert_eq!(
            values_of(input.means.grad(&grads).expect("tracked")),
            sum.collect::<Vec<f64>>()
        );
    }
}

#[test]
fn a_loss_on_the_transmittance_alone_reaches_the_geometry() {
    let device = crate::support::device().autodiff();
    let camera = camera(20, 15);
    let c = cloud(20, 0.05, &camera, 2);
    let values = numbers(c.len(), 4);
    let mut loss = Loss::new(&camera, 1);
    loss.image.fill(0.0);
    loss.transmittance.fill(1.0);
    let want = gradients(&c, &values, 1, &camera, &Settings::default(), &loss);
    let leaves = Leaves(
        [
            c.means.clone(),
            c.log_scales.clone(),
            c.rotations.clone(),
            c.opacity_logits.clone(),
            Vec::new(),
            values,
        ],
        0,
    );
    let input = leaves.tensors(&device);
    let out = rasterize(input.clone(), &camera, &Settings::default(), [0.0; 3]).expect("valid");
    let grads = out.transmittance.sum().backward();
    assert_eq!(
        values_of(input.opacity_logits.grad(&grads).expect("tracked")),
        want.opacity_logits
    );
    assert!(want.opacity_logits.iter().any(|&g| g < 0.0));
}
