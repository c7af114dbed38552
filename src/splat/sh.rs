//! Real spherical harmonics of degrees 0 to 3 in the sign and order of 3DGS.

/// Factor of degree 0, `1 / (2 sqrt(pi))`: a colour is `0.5 + SH_0 c` for a constant coefficient `c`.
pub const SH_0: f32 = C0 as f32;
/// Factors of the basis functions of each degree.
pub(crate) const C0: f64 = 0.282_094_791_773_878_14;
pub(crate) const C1: f64 = 0.488_602_511_902_919_9;
pub(crate) const C2: [f64; 5] = [
    1.092_548_430_592_079_2,
    -1.092_548_430_592_079_2,
    0.315_391_565_252_520_05,
    -1.092_548_430_592_079_2,
    0.546_274_215_296_039_6,
];
pub(crate) const C3: [f64; 7] = [
    -0.590_043_589_926_643_5,
    2.890_611_442_640_554,
    -0.457_045_799_464_465_8,
    0.373_176_332_590_115_4,
    -0.457_045_799_464_465_8,
    1.445_305_721_320_277,
    -0.590_043_589_926_643_5,
];

/// The 16 basis functions of degrees 0 to 3 at a unit direction. Those above `degree` are 0.
#[inline(always)]
pub(crate) fn basis([x, y, z]: [f64; 3], degree: usize) -> [f64; 16] {
    let mut b = [0.0; 16];
    b[0] = C0;
    if degree > 0 {
        [b[1], b[2], b[3]] = [-C1 * y, C1 * z, -C1 * x];
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    if degree > 1 {
        b[4] = C2[0] * x * y;
        b[5] = C2[1] * y * z;
        b[6] = C2[2] * (2.0 * zz - xx - yy);
        b[7] = C2[3] * x * z;
        b[8] = C2[4] * (xx - yy);
    }
    if degree > 2 {
        b[9] = C3[0] * y * (3.0 * xx - yy);
        b[10] = C3[1] * x * y * z;
        b[11] = C3[2] * y * (4.0 * zz - xx - yy);
        b[12] = C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
        b[13] = C3[4] * x * (4.0 * zz - xx - yy);
        b[14] = C3[5] * z * (xx - yy);
        b[15] = C3[6] * x * (xx - 3.0 * yy);
    }
    b
}
