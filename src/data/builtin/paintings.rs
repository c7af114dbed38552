//! Pictures for the walls, and the landscape outside the windows.

use super::noise::{band, cloud, fold, noise, rgb, step};
use glam::DVec3;

/// A picture in a white mat; `x`, `y` in -1..1 across the canvas, `y` up.
pub(super) fn painting(
    style: u32,
    [a, b, c]: [DVec3; 3],
    x: f64,
    y: f64,
    face: (f64, f64),
    seed: u64,
) -> DVec3 {
    let aspect = face.0 / face.1;
    let edge = ((1.0 - x.abs()) * face.0).min((1.0 - y.abs()) * face.1);
    let mat = 1.0 - step(0.045, 0.06, edge);
    let inside = match style {
        1 => blocks(x, y, [a, b, c]),
        2 => circles(x * aspect, y, [a, b, c], seed),
        4 => hills(x * aspect, y, seed),
        _ => fields(x, y, [a, b, c]),
    };
    inside.lerp(rgb(0xf2efe6), mat)
}

/// Rectangles of primary colours between dark bars.
fn blocks(x: f64, y: f64, [a, b, c]: [DVec3; 3]) -> DVec3 {
    let paper = rgb(0xece5d3);
    let left = x <= -0.3;
    let right = x > 0.45;
    let top = y > 0.25;
    let bottom = y <= -0.45;
    let inside = if left && top {
        a
    } else if right && bottom {
        b
    } else if left && bottom || right && top {
        c
    } else {
        paper
    };
    let bar = band(x + 0.3, 0.035, 0.03).max(band(y - 0.25, 0.04, 0.035));
    let bar = bar
        .max(band(x - 0.45, 0.03, 0.03))
        .max(band(y + 0.45, 0.035, 0.035));
    inside.lerp(rgb(0x222226), bar)
}

/// Overlapping discs and a ring.
fn circles(x: f64, y: f64, [a, b, c]: [DVec3; 3], seed: u64) -> DVec3 {
    let disc = |cx: f64, cy: f64, r: f64| 1.0 - step(r - 0.03, r + 0.03, (x - cx).hypot(y - cy));
    let k = 0.2 * noise(seed as f64 % 97.0, 0.5, seed);
    let ring = band((x + 0.15).hypot(y + 0.1) - 0.62, 0.05, 0.04);
    rgb(0xe9e1cf)
        .lerp(a, 0.9 * disc(-0.35 + k, 0.25, 0.45))
        .lerp(b, 0.8 * disc(0.35, -0.2 + k, 0.5))
        .lerp(c, 0.9 * disc(0.3 - k, 0.5, 0.22))
        .lerp(rgb(0x2b2b30), 0.85 * ring)
}

/// Two soft fields of colour on a ground.
fn fields(x: f64, y: f64, [a, b, c]: [DVec3; 3]) -> DVec3 {
    let patch = |cy: f64, hy: f64| band(x, 0.72, 0.14) * band(y - cy, hy, 0.14);
    c.lerp(a, patch(0.42, 0.3)).lerp(b, patch(-0.48, 0.26))
}

/// Receding green hills under a pale sky.
fn hills(x: f64, y: f64, seed: u64) -> DVec3 {
    let mut color = rgb(0xbcd6e6).lerp(rgb(0xf5ead0), step(0.9, 0.0, y));
    for (i, tone) in [0x8fa9a0, 0x6d9468, 0x4c7a43, 0x2f5a35]
        .into_iter()
        .enumerate()
    {
        let k = i as f64;
        let ridge = 0.35 - 0.36 * k + 0.3 * (noise(x * (1.2 + 0.3 * k) + 7.0 * k, k, seed) - 0.4);
        color = color.lerp(rgb(tone), 1.0 - step(ridge - 0.03, ridge + 0.03, y));
    }
    color
}

/// Sky, far hills, trees and a lawn; `azimuth` in radians along the horizon, `y` in -1..1 up the pane.
pub(super) fn scenery(azimuth: f64, y: f64) -> DVec3 {
    let x = azimuth * 6.0;
    let sky = rgb(0xdfeaf2).lerp(rgb(0x8db8e2), step(-0.2, 1.0, y));
    let clouds = step(0.52, 0.8, cloud(x * 0.5, y * 1.6, 11));
    let mut c = sky.lerp(rgb(0xffffff), 0.7 * clouds * step(-0.1, 0.3, y));
    let far = -0.12 + 0.35 * (noise(x * 0.6, 0.0, 5) - 0.5);
    c = c.lerp(rgb(0x9db7b0), 1.0 - step(far - 0.04, far + 0.04, y));
    let crown = -0.3
        + 0.55 * (0.5 - fold(x, 1.7).abs() / 1.7) * (0.5 + noise((x / 1.7).round() * 3.7, 0.3, 9));
    let trees = 1.0
        - step(
            crown - 0.06,
            crown + 0.06,
            y + 0.12 * (noise(x * 5.0, y * 5.0, 3) - 0.5),
        );
    c = c.lerp(
        rgb(0x5f8a55).lerp(rgb(0x3c6640), noise(x * 3.0, y * 3.0, 8)),
        trees,
    );
    c.lerp(rgb(0x9cbf6d), 1.0 - step(-0.62, -0.54, y))
}
