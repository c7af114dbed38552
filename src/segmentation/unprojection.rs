//! placeholder
use crate::config::UnprojectionConfig; use crate::data::View; use crate::features::FeatureSet; use crate::gaussians::Gaussians; use crate::raster::Settings; use crate::error::Result;
/// x
pub struct U { /// x
 pub features: [Vec<f32>;4], /// x
 pub keep: Vec<bool> }
/// x
pub fn unproject<'a>(_g:&Gaussians,_v: impl Iterator<Item=&'a View>,_f:&FeatureSet,_c:&UnprojectionConfig,_s:&Settings)->Result<U>{ unimplemented!() }
