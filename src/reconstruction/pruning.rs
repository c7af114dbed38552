//! Which Gaussians a scene can do without: what each adds to the pictures, and how many of them some views need.
//!
//! The colour of a pixel is an affine function of the alpha of each Gaussian, except in pixels that end early. Leaving Gaussian
//! `i` out changes it by `dC = -alpha_i dC/d(alpha_i)`, or `-dC/do / sigmoid(-o)` in terms of the logit `o` of the opacity. So
//! the backward pass of the rasterizer gives sums of `-dC` over the pixels, weighted by the gradient that it is given. With
//! random signs as that gradient, the square of the sum is an unbiased estimate of the sum of `|dC|^2` (Hutchinson 1989). This is
//! the sensitivity that PUP-3DGS (Hanson et al. 2025) and Speedy-Splat (Hanson et al. 2025) approximate, without an approximation
//! in the alpha.

use super::optimizer::{Parameters, zero_moments};
use crate::backend::device::{read, upload};
use crate::config::RasterConfig;
use crate::data::View;
use crate::error::Result;
use crate::metrics::masked_psnr;
use crate::ops::sum_all;
use crate::raster::{RasterInput, Settings, rasterize};
use crate::splat::Gaussians;
use burn::tensor::activation::sigmoid;
use burn::tensor::{Device, Tensor};
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// Logits above this are measured as if they had this value, an opacity of 0.999: beyond, `sigmoid(-o)` vanishes in f32.
const MAX_LOGIT: f64 = 7.0;
/// A logit that renders nothing.
const LEFT_OUT: f32 = -30.0;
/// Halvings of the interval in which the share of Gaussians to leave out is searched.
const HALVINGS: usize = 8;

/// Gaussians on a device, and how they are rendered.
pub(crate) struct PrunedScene {
    pub leaves: RasterInput,
    pub settings: Settings,
    pub background: [f32; 3],
}

impl PrunedScene {
    /// `gaussians` with their settings, on `device`.
    pub fn new(gaussians: &Gaussians, raster: &RasterConfig, device: &Device) -> Self {
        let moments = zero_moments(gaussians);
        let device = device.clone().inner();
        let parameters = Parameters::new(gaussians.clone(), moments.clone(), moments, &device);
        Self {
            leaves: parameters.leaves(gaussians.sh_degree),
            settings: Settings::from(raster),
            background: raster.background,
        }
    }

    /// Estimates of what the pictures of `views` lose without each Gaussian: the sum over views, pixels and channels of the squared
    /// change, `[N]`.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when the device does not return the gradients.
    pub fn costs(&self, views: &[&View], rng: &mut ChaCha8Rng) -> Result<Vec<f64>> {
        let mut costs = vec![0.0; self.leaves.opacity_logits.dims()[0]];
        for view in views {
            let changes = self.changes(view, random_signs(view, rng))?;
            for (cost, change) in costs.iter_mut().zip(changes) {
                *cost += f64::from(change).powi(2);
            }
        }
        Ok(costs)
    }

    /// What each Gaussian adds to the sum of the values of a picture times `weights` (`[H, W, 3]`), `[N]`.
    fn changes(&self, view: &View, weights: Vec<f32>) -> Result<Vec<f32>> {
        // Where alpha' is capped, its gradient is masked.
        let settings = Settings {
            alpha_max: 1.0,
            ..self.settings
        };
        let logits = self.leaves.opacity_logits.clone().inner();
        let logits = logits.clamp_max(MAX_LOGIT);
        let tracked = Tensor::from_inner(logits.clone()).require_grad();
        let image = self.image(view, tracked.clone(), &settings)?;
        let weights = upload(weights, image.dims(), &logits.device());
        let mut gradients = sum_all(image * Tensor::from_inner(weights)).backward();
        let gradient = tracked.grad_remove(&mut gradients);
        let gradient = gradient.unwrap_or_else(|| logits.zeros_like());
        read("changes of the pictures", gradient / sigmoid(logits.neg()))
    }

    /// The Gaussians that stay, in their order. As many of the cheapest as possible are left out, but fewer than `most`, while the
    /// mean PSNR of `views` stays at `least` dB or above.
    ///
    /// # Errors
    /// Those of [`crate::data::Photo::pixels`], and [`crate::Error::Device`] when the device does not return the pictures.
    pub fn prune(
        &self,
        costs: &[f64],
        views: &[&View],
        least: f64,
        most: usize,
    ) -> Result<Vec<u32>> {
        let order = cheapest_first(costs);
        let mut left_out = 0;
        let mut step = most / 2;
        for _ in 0..HALVINGS {
            let tried = left_out + step;
            if self.psnr(views, &order[..tried])? >= least {
                left_out = tried;
            }
            step /= 2;
        }
        Ok(ascending(&order[left_out..]))
    }

    /// Mean PSNR of `views` without the Gaussians `left_out`, dB. Views that their masks hide do not count; 0 if there are no others.
    ///
    /// # Errors
    /// As [`Self::prune`].
    pub fn psnr(&self, views: &[&View], left_out: &[u32]) -> Result<f64> {
        let logits = self.leaves.opacity_logits.clone().inner();
        let mut values = read("opacity logits", logits.clone())?;
        left_out.iter().for_each(|&i| values[i as usize] = LEFT_OUT);
        let logits = upload(values, logits.dims(), &logits.device());
        let (mut sum, mut count) = (0.0, 0);
        for view in views {
            let image = self.image(view, logits.clone(), &self.settings)?;
            let image = read("image", image)?;
            let photo = view.rgb()?;
            if let Some(score) = masked_psnr(&image, &photo, view.mask.as_ref()) {
                sum += score;
                count += 1;
            }
        }
        Ok(sum / f64::from(count.max(1)))
    }

    fn image(&self, view: &View, logits: Tensor<1>, settings: &Settings) -> Result<Tensor<3>> {
        let input = RasterInput {
            opacity_logits: logits,
            ..self.leaves.clone()
        };
        Ok(rasterize(input, &view.camera, settings, self.background)?.image)
    }
}

/// Rows by ascending cost, ties by row.
pub(crate) fn cheapest_first(costs: &[f64]) -> Vec<u32> {
    let mut order: Vec<u32> = (0..costs.len() as u32).collect();
    order.sort_by(|&a, &b| costs[a as usize].total_cmp(&costs[b as usize]));
    order
}

pub(crate) fn ascending(rows: &[u32]) -> Vec<u32> {
    let mut rows = rows.to_vec();
    rows.sort_unstable();
    rows
}

/// 1 or -1 for each value of the picture of `view`, `[H, W, 3]`; 0 where its mask hides the photo.
fn random_signs(view: &View, rng: &mut ChaCha8Rng) -> Vec<f32> {
    let pixels = view.camera.width * view.camera.height;
    let mut signs = Vec::with_capacity(3 * pixels);
    for pixel in 0..pixels {
        let bits: u8 = rng.random();
        let used = view.mask.as_ref().is_none_or(|mask| mask.uses(pixel));
        for channel in 0..3 {
            let sign = if bits >> channel & 1 == 1 { 1.0 } else { -1.0 };
            signs.push(if used { sign } else { 0.0 });
        }
    }
    signs
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::device::{BackendName, device_of_tests};
    use crate::config::Config;
    use crate::data::builtin::{BuiltinOptions, scene_with};
    use crate::data::mask::Mask;
    use crate::data::{Scene, Split};
    use crate::random::{Purpose, stream};
    use crate::reconstruction::initialization::initial_gaussians;

    const VIEWS: usize = 2;

    fn photos() -> Scene {
        let options = BuiltinOptions {
            width: 48,
            height: 36,
            train_views: VIEWS,
            test_views: 1,
            points: 120,
            ..BuiltinOptions::default()
        };
        scene_with(&options).expect("a scene")
    }

    /// Initial Gaussians with opacities from 0.02 to 0.9995; every fourth stands where no view sees it.
    fn gaussians(photos: &Scene, device: &Device) -> PrunedScene {
        let train: Vec<&View> = photos.split(Split::Train).collect();
        let mut gaussians = initial_gaussians(photos, &train, &Config::default()).expect("points");
        for i in 0..gaussians.len() {
            gaussians.opacity_logits[i] = (i * 7 % 23) as f32 * 0.5 - 4.0;
            if i % 4 == 0 {
                gaussians.means[i] = [0.0, 1e3, 0.0];
            }
        }
        let raster = RasterConfig {
            background: [0.2, 0.4, 0.6],
            ..RasterConfig::default()
        };
        let mut scene = PrunedScene::new(&gaussians, &raster, device);
        // A pixel that ends early is not an affine function of what it does not reach.
        scene.settings.t_min = 0.0;
        scene
    }

    /// The picture of `view` without Gaussian `i`.
    fn without(scene: &PrunedScene, view: &View, i: Option<usize>) -> Vec<f64> {
        let logits = scene.leaves.opacity_logits.clone().inner();
        let device = logits.device();
        let mut values: Vec<f32> = read("logits", logits.clamp_max(MAX_LOGIT)).expect("readable");
        if let Some(i) = i {
            values[i] = LEFT_OUT;
        }
        let n = values.len();
        let settings = Settings {
            alpha_max: 1.0,
            ..scene.settings
        };
        let image = scene.image(view, upload(values, [n], &device), &settings);
        let image = read("image", image.expect("finite")).expect("readable");
        image.into_iter().map(f64::from).collect()
    }

    fn train(photos: &Scene) -> Vec<&View> {
        photos.split(Split::Train).collect()
    }

    #[test]
    fn changes_are_those_of_pictures_without_a_gaussian_on_every_device() {
        let photos = photos();
        for &name in BackendName::compiled() {
            let Some(device) = device_of_tests(name) else {
                continue;
            };
            let scene = gaussians(&photos, &device);
            for view in train(&photos) {
                let signs = random_signs(view, &mut stream(1, Purpose::Pruning, 0));
                let all = without(&scene, view, None);
                let changes = scene.changes(view, signs.clone()).expect("finite");
                for (i, &change) in changes.iter().enumerate() {
                    let left = without(&scene, view, Some(i));
                    let terms = all.iter().zip(&left).zip(&signs);
                    let want: f64 = terms.map(|((a, b), &s)| (a - b) * f64::from(s)).sum();
                    let error = (f64::from(change) - want).abs();
                    assert!(error <= 2e-3, "{i} on {name}: {change} for {want}");
                }
            }
        }
    }

    #[test]
    fn costs_are_squared_changes_in_the_mean() {
        const DRAWS: u64 = 400;
        let photos = photos();
        let scene = gaussians(&photos, &Device::ndarray());
        let views = train(&photos);
        let all = without(&scene, views[0], None);
        let n = scene.leaves.opacity_logits.dims()[0];
        let mut mean = vec![0.0; n];
        for draw in 0..DRAWS {
            let mut rng = stream(1, Purpose::Pruning, draw);
            let costs = scene.costs(&views[..1], &mut rng).expect("finite");
            mean.iter_mut()
                .zip(costs)
                .for_each(|(m, c)| *m += c / DRAWS as f64);
        }
        for (i, mean) in mean.into_iter().enumerate() {
            let left = without(&scene, views[0], Some(i));
            let want: f64 = all.iter().zip(&left).map(|(a, b)| (a - b).powi(2)).sum();
            // The deviation of a draw is at most sqrt(2) of its mean.
            let bound = 4.0 * (2.0 / DRAWS as f64).sqrt() * want + 1e-6;
            assert!((mean - want).abs() <= bound, "{i}: {mean} for {want}");
        }
    }

    #[test]
    fn a_view_that_its_mask_hides_does_not_count() {
        let mut photos = photos();
        let of = |photos: &Scene, views: usize| {
            let scene = gaussians(photos, &Device::ndarray());
            let psnr = scene.psnr(&train(photos)[..views], &[]);
            psnr.expect("rendered")
        };
        let first = of(&photos, 1);
        assert_ne!(of(&photos, 2), first);
        let second = photos
            .views
            .iter_mut()
            .filter(|view| view.split == Split::Train);
        let second = second.last().expect("two views");
        second.mask = Some(Mask::new(48, 36, |_| false));
        assert_eq!(of(&photos, 2), first);
    }

    #[test]
    fn what_no_view_sees_is_left_out_first() {
        let photos = photos();
        let scene = gaussians(&photos, &Device::ndarray());
        let views = train(&photos);
        let mut rng = stream(1, Purpose::Pruning, 0);
        let costs = scene.costs(&views, &mut rng).expect("finite");
        let before = scene.psnr(&views, &[]).expect("rendered");
        let prune = |loss: f64| {
            scene
                .prune(&costs, &views, before - loss, costs.len())
                .expect("rendered")
        };
        let exact = prune(0.0);
        assert!(exact.len() <= costs.len() - costs.len() / 4 + costs.len() / 32);
        let lossy = prune(1.0);
        assert!(lossy.len() < exact.len() && lossy.is_sorted());
        assert!(lossy.iter().all(|i| i % 4 != 0));
        let gone: Vec<u32> = (0..costs.len() as u32)
            .filter(|i| !lossy.contains(i))
            .collect();
        let after = scene.psnr(&views, &gone).expect("rendered");
        assert!(
            after >= before - 1.0 && after < before,
            "{after} of {before} dB"
        );
    }
}
