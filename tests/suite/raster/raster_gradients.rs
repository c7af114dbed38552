//! Gradients of the rasterizer against finite differences in f64, and of the operation against the slices.
//!
//! The contract: |analytic - numeric| <= 1e-6 max(|analytic|, rms of the tensor); a NaN fails, and a gradient that is
//! 1 % off must be caught.

use crate::support::raster_reference::{self as reference, Cloud, camera, cloud, numbers};
use burn::tensor::{DType, Tensor, TensorData};
use coseg::raster::{Projected, RasterInput, Settings, SplatGradients, rasterize};
use coseg::splat::camera::Camera;

/// `Err` names the first entry that breaks the contract.
fn agree(analytic: &[f64], numeric: &[f64]) -> Result<(), String> {
    assert_eq!(analytic.len(), numeric.len());
    let rms = (numeric.iter().map(|v| v * v).sum::<f64>() / numeric.len() as f64).sqrt();
    for (i, (&a, &n)) in analytic.iter().zip(numeric).enumerate() {
        let within = (a - n).abs() <= 1e-6 * a.abs().max(rms);
        if !(a.is_finite() && n.is_finite() && within) {
            return Err(format!("entry {i}: analytic {a}, numeric {n}, rms {rms}"));
        }
    }
    Ok(())
}

/// [`agree`], and that it would have seen a corrupted gradient.
fn check(what: &str, analytic: &[f64], numeric: &[f64]) {
    agree(analytic, numeric).unwrap_or_else(|e| panic!("{what}: {e}"));
    assert!(
        analytic.iter().any(|&a| a != 0.0),
        "{what}: all zero, the check would be empty"
    );
    let off: Vec<f64> = analytic.iter().map(|a| a * 1.01).collect();
    assert!(
        agree(&off, numeric).is_err(),
        "{what}: a gradient 1 % off goes unnoticed"
    );
    let mut broken = analytic.to_vec();
    broken[0] = f64::NAN;
    assert!(
        agree(&broken, numeric).is_err(),
        "{what}: a NaN goes unnoticed"
    );
}

/// Central differences of `f` at every entry of `x`, with a relative step in the entry's own size.
fn differences(x: &[f64], step: f64, mut f: impl FnMut(&[f64]) -> f64) -> Vec<f64> {
    let mut x = x.to_vec();
    (0..x.len())
        .map(|i| {
            let x0 = x[i];
            let mut at = |k: f64| {
                x[i] = x0 + k * step;
                f(&x)
            };
            // Five points: the error is of fourth order in the step.
            let d = (8.0 * (at(1.0) - at(-1.0)) - (at(2.0) - at(-2.0))) / (12.0 * step);
            x[i] = x0;
            d
        })
        .collect()
}

/// A linear loss over image and transmittance.
struct Loss {
    image: Vec<f64>,
    transmittance: Vec<f64>,
}

impl Loss {
    fn new(camera: &Camera, channels: usize) -> Self {
        let pixels = camera.width * camera.height;
        Self {
            image: numbers(pixels * channels, 77),
            transmittance: numbers(pixels, 78),
        }
    }

    fn of(&self, image: &[f64], transmittance: &[f64]) -> f64 {
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        dot(&self.image, image) + dot(&self.transmittance, transmittance)
    }
}

const SMOOTH: Settings = Settings {
    alpha_max: 1.0,
    alpha_min: 0.0,
    t_min: 0.0,
    near: 0.01,
    low_pass: 0.3,
};

fn loss_of(
    c: &Cloud,
    values: &[f64],
    channels: usize,
    camera: &Camera,
    s: &Settings,
    loss: &Loss,
) -> f64 {
    let out = Projected::new(&c.splats(), camera, s)
        .expect("valid")
        .blend(values, channels);
    loss.of(&out.image, &out.transmittance)
}

fn gradients(
    c: &Cloud,
    values: &[f64],
    channels: usize,
    camera: &Camera,
    s: &Settings,
    l: &Loss,
) -> SplatGradients<f64> {
    let projected = Projected::new(&c.splats(), camera, s).expect("valid");
    let forward = projected.blend(values, channels);
    projected.backward(
        &c.splats(),
        values,
        channels,
        &forward,
        &l.image,
        Some(&l.transmittance),
    )
}

/// Checks every input of one scene.
fn check_scene(what: &str, c: &Cloud, channels: usize, camera: &Camera, s: &Settings, step: f64) {
    let values = numbers(c.len() * channels, 5);
    let loss = Loss::new(camera, channels);
    let got = gradients(c, &values, channels, camera, s, &loss);
    let varied = |pick: fn(&mut Cloud) -> &mut Vec<f64>| {
        let mut c = c.clone();
        let x = pick(&mut c).clone();
        differences(&x, step, |x| {
            pick(&mut c).copy_from_slice(x);
            loss_of(&c, &values, channels, camera, s, &loss)
        })
    };
    let name = |tensor: &str| format!("{what}, {channels} channels, {tensor}");
    check(&name("means"), &got.means, &varied(|c| &mut c.means));
    check(
        &name("log_scales"),
        &got.log_scales,
        &varied(|c| &mut c.log_scales),
    );
    check(
        &name("rotations"),
        &got.rotations,
        &varied(|c| &mut c.rotations),
    );
    check(
        &name("opacity_logits"),
        &got.opacity_logits,
        &varied(|c| &mut c.opacity_logits),
    );
    if channels > 0 {
        let d_values = differences(&values, step, |v| loss_of(c, v, channels, camera, s, &loss));
        check(&name("values"), &got.values, &d_values);
    }
    // The projected centres: the reference renderer can move them one by one.
    let mut shifts = vec![0.0; 2 * c.len()];
    let screen = differences(&shifts.clone(), step, |x| {
        shifts.copy_from_slice(x);
        let out = reference::render_shifted(c, &values, channels, camera, s, &shifts);
        loss.of(&out.image, &out.transmittance)
    });
    let half = [camera.width as f64 / 2.0, camera.height as f64 / 2.0];
    let screen: Vec<f64> = screen
        .iter()
        .enumerate()
        .map(|(i, d)| d * half[i % 2])
        .collect();
    check(&name("screen"), &got.screen, &screen);
}

#[test]
fn smooth_gradients_equal_finite_differences() {
    let camera = camera(23, 18);
    for channels in [0, 1, 2, 3, 4, 5, 13, 23, 70] {
        let scene = cloud(12, 0.06, &camera, 3);
        check_scene("smooth", &scene, channels, &camera, &SMOOTH, 1e-4);
    }
}

#[test]
fn gradients_with_the_default_cut_offs_equal_finite_differences() {
    let camera = camera(23, 18);
    for settings in [
        Settings::default(),
        Settings {
            alpha_max: 0.5,
            t_min: 0.2,
            ..Settings::default()
        },
    ] {
        // A scene in which no pair lies so close to a cut-off that a finite step would cross it.
        let (seed, scene) = (0..1000)
            .map(|seed| (seed, cloud(10, 0.06, &camera, seed)))
            .find(|(_, c)| {
                reference::render(c, &numbers(30, 5), 3, &camera, &settings).closest_cut > 4e-4
            })
            .expect("such a scene");
        for channels in [3, 9] {
            check_scene(
                &format!("cut-offs, seed {seed}"),
                &scene,
                channels,
                &camera,
                &settings,
                1e-6,
            );
        }
    }
}

#[test]
fn gradients_of_awkward_geometry_equal_finite_differences() {
    let camera = camera(23, 18);
    let at = |u: f64, v: f64, z: f64| (camera.center + camera.ray(u, v) * z).to_array();
    let mut c = Cloud::default();
    // Needles and plates, a quaternion far from unit length, and centres outside the limits of the Jacobian.
    c.push(
        at(8.0, 9.0, 2.0),
        [1e-4, 1e-4, 0.3],
        [0.3, -0.5, 0.8, 0.1],
        1.0,
    );
    c.push(
        at(12.0, 5.0, 2.5),
        [1e-5, 0.4, 0.3],
        [3.0, 40.0, -25.0, 11.0],
        -0.5,
    );
    c.push(
        at(-9.0, 8.0, 3.0),
        [0.9, 0.8, 1.1],
        [0.9, 0.2, 0.1, -0.3],
        0.5,
    );
    c.push(
        at(12.0, 32.0, 2.2),
        [0.8, 0.9, 0.7],
        [0.1, 0.2, -0.7, 0.4],
        0.3,
    );
    c.push(
        at(14.0, 12.0, 4.0),
        [0.2, 0.2, 0.2],
        [0.5, 0.5, 0.5, 0.5],
        4.0,
    );
    check_scene("awkward", &c, 3, &camera, &SMOOTH, 1e-5);
}

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
    for features in [1, 3, 6, 20] {
        let values = numbers(n * features, 4);
        let loss = Loss::new(&camera, features);
        let want = gradients(&c, &values, features, &camera, &Settings::default(), &loss);
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
        let input = leaves.tensors(&device);
        let out = rasterize(input.clone(), &camera, &Settings::default(), [0.5; 3]).expect("valid");
        let projected = Projected::new(&c.splats(), &camera, &Settings::default()).expect("valid");
        let blended = projected.blend(&values, features);
        assert_eq!(
            values_of(out.radii.clone()),
            projected
                .radii()
                .iter()
                .map(|&radius| f64::from(radius))
                .collect::<Vec<f64>>()
        );
        assert_eq!(values_of(out.image.clone()), blended.image);
        assert_eq!(values_of(out.transmittance.clone()), blended.transmittance);
        let data = |v: &[f64], shape: Vec<usize>| TensorData::new(v.to_vec(), shape);
        let weights = data(&loss.image, vec![camera.height, camera.width, features]);
        let image = out.image * Tensor::<3>::from_data(weights, (&device, DType::F64));
        let weights = data(&loss.transmittance, vec![camera.height, camera.width]);
        let t = out.transmittance * Tensor::<2>::from_data(weights, (&device, DType::F64));
        let grads = (image.sum() + t.sum()).backward();
        assert_eq!(
            values_of(input.means.grad(&grads).expect("tracked")),
            want.means
        );
        assert_eq!(
            values_of(input.log_scales.grad(&grads).expect("tracked")),
            want.log_scales
        );
        assert_eq!(
            values_of(input.rotations.grad(&grads).expect("tracked")),
            want.rotations
        );
        assert_eq!(
            values_of(input.opacity_logits.grad(&grads).expect("tracked")),
            want.opacity_logits
        );
        assert_eq!(
            values_of(
                input
                    .features
                    .expect("given")
                    .grad(&grads)
                    .expect("tracked")
            ),
            want.values
        );
        assert_eq!(
            values_of(input.screen.expect("given").grad(&grads).expect("tracked")),
            want.screen
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
