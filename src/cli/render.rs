//! `coseg render`: pictures of a PLY scene.

use super::annotations::{AnnotationFormat, Annotations};
use super::film;
use super::frame_files::{Format, FrameFiles};
use super::render_path::{PATTERN, PathArgs};
use super::values::{alpha_max, numbers};
use super::{BackendArgs, terminal};
use burn::tensor::Device;
use clap::{Args, ValueEnum};
use coseg::config::Config;
use coseg::data::formats::transforms;
use coseg::data::labels::annotations::Categories;
use coseg::data::{LoadOptions, NamedCamera, Split, ViewPhoto, check_outputs};
use coseg::error::{Result, ensure};
use coseg::features::FeatureColors;
use coseg::files::MAX_IMAGE_PIXELS;
use coseg::objects::{RenderOptions, Renderer};
use coseg::runs::{
    CAMERAS, FEATURE_COLORS, cameras_for, cameras_path, classes_beside, photos_of, read_scene,
    rendering_beside, scene_path, without_labels,
};
use coseg::splat::Gaussians;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

const HELP: &str = "\
For each frame, with STEM its file name without extension, the output folder gets
  --format npy   STEM.rgb.npy    [H, W, 3] float32, not clamped, with the background
                 STEM.alpha.npy  [H, W] float32, how much of the background is covered (1 - transmittance)
  --format png   STEM.rgb.png    8 bits a channel
                 STEM.alpha.png  8-bit grey
  --labels       STEM.label.png  the label with the largest blended weight; the id that classes.json ignores, or 0, where alpha
                                 is below the run's segmentation.min_coverage, or 0.5; 8-bit grey, 16-bit for ids above 255
                 STEM.label_color.png  the same in colours, with a legend, where classes.json is beside the scene
  --features pca STEM.features.png (npy: [H, W, 3] float32)  the three main components of the image features that
                 `coseg train` lifted onto the Gaussians, as red, green and blue, blended over the background: similar
                 colours mean similar features. Needs feature_colors.safetensors beside the scene
  --depth        STEM.depth.png  16-bit grey, thousandths of a world unit along the viewing direction; npy: [H, W] float32,
                 world units. The mean of the Gaussians that a pixel shows; 0 where alpha is below the run's
                 segmentation.min_coverage, or 0.5
  --normals      STEM.normal.png  8 bits a channel, 127.5 (n + 1) of the world direction n; npy: [H, W, 3] float32. The
                 shortest axes of the Gaussians that a pixel shows, turned towards the camera; 0 where alpha is too low
  --annotations coco   instances.json: COCO instances with run lengths, one a label and frame, whose key `label` is its id.
                       An image has the file name of the photo, or STEM.png where no photo fits the map. An object has the
                       category of its class
                yolo   data.yaml, train.txt, val.txt, labels/STEM.txt, images/: a data set for YOLO segmentation, a line a
                       connected region. images/ has copies of the photos, or the rendered pictures where no photo fits. The
                       list of a split that is not rendered stays
                index  STEM.index.png: 8-bit PNG with the colours of the classes as its palette

Cameras
  transforms.json  instant-ngp and nerfstudio, with w and h
  cameras.json     of a run, or of graphdeco's 3DGS
  camera path      of nerfstudio's viewer, in its normalised coordinates, for the PLY of its ns-export
  DIR              a run folder, or a scene folder of any layout; data.dataparser_transforms of the run beside the scene
                   moves the cameras of a scene folder to nerfstudio's world

Where the config.toml of a run is beside the scene, its raster settings apply, and the pictures equal those in the run's
renders folder. Label maps show the PLY's label of each Gaussian. Only a run with segmentation.render = \"scores\", as in
the preset \"paper\", has other ones, from blended scores.

Paths: frames path_0000, path_0001, ... and their cameras as cameras.json.
  --path              sway where the cameras look one way, as at a wall, else orbit
  --path interpolate  through the cameras in file order, of --split if given; turns on the spot take frames as well
  --path sway         on a small ellipse among the cameras, looking where they look
  --path orbit        once around the point that the cameras look at, at their median distance and height, with the lens
                      of the first one; lower --radius in rooms, where furniture and walls may be in the way
  --object OBJECT     around the box of one object, closer to a small one; `coseg edit --keep OBJECT` isolates it
  --film              film.mp4 of the frames, with ffmpeg

Examples:
  coseg render --scene runs/room --out pictures --split test --labels
  coseg render --scene runs/room --out walk --path interpolate --split train --frames 300 --size 1280,960
  coseg render --scene runs/room --out dataset --labels --annotations coco,yolo
  coseg render --scene runs/room --out film --path --film
  coseg render --scene runs/room --out features --split test --features pca
  coseg render --scene runs/room --out sofa --path orbit --object sofa
  coseg render --scene other.ply --cameras path.json --out arrays --format npy --background 1,1,1 --alpha-max 0.99";

/// Arguments of `coseg render`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct RenderArgs {
    /// Scene, a PLY, .spz, .sog or .splat file, or its folder; --labels needs its labels
    #[arg(long, value_name = "FILE|DIR")]
    scene: PathBuf,
    /// Cameras of this or another tool, see below [default: cameras.json beside the scene]
    #[arg(long, value_name = "FILE.json|DIR")]
    cameras: Option<PathBuf>,
    /// Folder to write to; made if absent
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Kind of files: 8-bit images or float32 arrays
    #[arg(long, value_enum, default_value_t = Format::Png)]
    format: Format,
    /// Which frames
    #[arg(long, value_enum, default_value_t = SplitArg::All)]
    split: SplitArg,
    #[command(flatten)]
    path: PathArgs,
    /// Size of the images, pixels; another aspect shows more or less at the sides [default: as given]
    #[arg(long, value_name = "W,H", value_parser = parse_size)]
    size: Option<[usize; 2]>,
    /// Render the labels too
    #[arg(long)]
    labels: bool,
    /// Write the labels as annotations too
    #[arg(
        long,
        value_enum,
        value_name = "FORMAT,...",
        value_delimiter = ',',
        requires = "labels"
    )]
    annotations: Vec<AnnotationFormat>,
    /// Render the depth too
    #[arg(long)]
    depth: bool,
    /// Render the normals too
    #[arg(long)]
    normals: bool,
    /// Render the image features of a run too, in colours
    #[arg(long, value_enum, value_name = "KIND")]
    features: Option<FeatureKind>,
    /// Colour behind the scene, each 0 to 1 [default: the run's, or 0,0,0]
    #[arg(long, value_name = "R,G,B", value_parser = parse_color, allow_hyphen_values = true)]
    background: Option<[f32; 3]>,
    /// Cap of a splat's opacity at a pixel, in (0, 1]; graphdeco has 0.99 [default: the run's, or 0.999]
    #[arg(long, value_name = "X", value_parser = alpha_max, allow_negative_numbers = true)]
    alpha_max: Option<f64>,
    #[command(flatten)]
    backend: BackendArgs,
}

/// How image features become colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum FeatureKind {
    /// Their three main components
    Pca,
}

/// A split, or all frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum SplitArg {
    Train,
    Test,
    All,
}

fn parse_color(text: &str) -> std::result::Result<[f32; 3], String> {
    let color = numbers(text, ',').filter(|color| color.iter().all(|v| (0.0..=1.0).contains(v)));
    let expected = "expected three numbers from 0 to 1 separated by commas, for instance 1,1,1";
    color.ok_or_else(|| expected.into())
}

/// No more pixels than an image may have.
fn parse_size(text: &str) -> std::result::Result<[usize; 2], String> {
    let most = MAX_IMAGE_PIXELS;
    let fits = |&[w, h]: &[usize; 2]| w > 0 && h > 0 && (w as u64).saturating_mul(h as u64) <= most;
    let size = numbers(text, ',').filter(fits);
    size.ok_or_else(|| {
        format!("expected a width and a height, at most {most} pixels, for instance 1280,720")
    })
}

impl RenderArgs {
    /// Renders every frame.
    pub fn run(self) -> Result<()> {
        let path = scene_path(&self.scene)?;
        let key_file = cameras_path(self.cameras.as_deref(), &path)?;
        let config = self.config(&path);
        self.check(&key_file, &config)?;
        let keys = self.keys(&path, &key_file)?;
        let scene = read_scene(&path)?;
        if self.labels && scene.labels.is_none() {
            return Err(without_labels(&path));
        }
        let classes = classes_beside(&path, None)?;
        let along = self.path.cameras(&keys, &path, &scene)?;
        let is_path = along.is_some();
        let cameras = along.unwrap_or(keys);
        let labels = scene.labels.filter(|_| self.labels);
        let categories = Categories::new(&classes, labels.iter().flatten().copied());
        let photos = self.photos(&key_file, is_path);
        let mut annotations =
            Annotations::new(&self.annotations, &categories, &classes, &self.out, photos);
        annotations.check(&cameras)?;
        let options = RenderOptions {
            unlabelled: classes.ignore,
            ..RenderOptions::from(&config)
        };
        let device = self.backend.open()?;
        let features = self.feature_renderer(&path, &scene.gaussians, options, &device)?;
        let renderer = Renderer::new(scene.gaussians, labels, options, &device)?;
        if is_path {
            transforms::write_cameras(&self.out.join(CAMERAS), &cameras)?;
        }
        let bar = terminal::bar("render", cameras.len() as u64);
        let mut times = Vec::with_capacity(cameras.len());
        for named in &cameras {
            let camera = named.camera.moved(-scene.origin);
            let start = Instant::now();
            let frame = renderer.frame(&camera)?;
            times.push(start.elapsed().as_secs_f64());
            let files = self.files(&named.name);
            files.write(&frame, &classes)?;
            let size = [frame.width, frame.height];
            if self.depth {
                files.write_depth(size, &renderer.depth(&camera)?)?;
            }
            if self.normals {
                files.write_normals(size, &renderer.normals(&camera)?)?;
            }
            annotations.add(named, &frame)?;
            if let Some(features) = &features {
                files.write_color("features", size, &features.frame(&camera)?.rgb)?;
            }
            bar.inc(1);
        }
        bar.finish_and_clear();
        annotations.finish()?;
        self.conclude(&times)
    }

    /// The settings of the run that the scene `path` belongs to, with those of the command line.
    fn config(&self, path: &Path) -> Config {
        let mut config = rendering_beside(path);
        let raster = &mut config.raster;
        raster.alpha_max = self.alpha_max.unwrap_or(raster.alpha_max);
        raster.background = self.background.unwrap_or(raster.background);
        config
    }

    /// Refuses an output that would harm the scene or the file of cameras `keys`, or that lacks what it needs.
    fn check(&self, keys: &Path, config: &Config) -> Result<()> {
        self.path.check(&self.out, keys)?;
        if self.path.film {
            ensure!(self.format == Format::Png, argument "--film"; found "--format npy"; expected "--format png";
                help "leave one of them out");
            film::check(&self.out)?;
        }
        let folder = self.cameras.as_deref().filter(|dir| dir.is_dir());
        let scene = folder.or(config.data.dir.as_deref());
        let options = LoadOptions::from(config);
        check_outputs("--out", &[&self.out], scene.map(|dir| (dir, &options)))
    }

    /// The cameras of the file or folder `keys` that the split has, for the scene `path`, in the size asked for.
    fn keys(&self, path: &Path, keys: &Path) -> Result<Vec<NamedCamera>> {
        let split = match self.split {
            SplitArg::Train => Some(Split::Train),
            SplitArg::Test => Some(Split::Test),
            SplitArg::All => None,
        };
        let mut cameras = cameras_for(path, keys, split)?;
        if let Some([width, height]) = self.size {
            for named in &mut cameras {
                named.camera = named.camera.with_size(width, height);
            }
        }
        Ok(cameras)
    }

    /// The photos of the views of `keys`, where annotations need them. The frames of a path have none.
    fn photos(&self, keys: &Path, is_path: bool) -> BTreeMap<String, ViewPhoto> {
        let of_photos = [AnnotationFormat::Coco, AnnotationFormat::Yolo];
        let are_asked_for = self
            .annotations
            .iter()
            .any(|format| of_photos.contains(format));
        if is_path || !are_asked_for {
            return BTreeMap::new();
        }
        photos_of(keys)
    }

    fn files<'a>(&'a self, name: &'a str) -> FrameFiles<'a> {
        FrameFiles {
            folder: &self.out,
            name,
            format: self.format,
        }
    }

    /// Makes the film, and says what was rendered and how long each frame took.
    fn conclude(&self, times: &[f64]) -> Result<()> {
        if self.path.film {
            let film = film::write(&self.out, PATTERN)?;
            terminal::say(&format!("film: {}", film.display()));
        }
        let mut said = format!("{} frames in {}", times.len(), self.out.display());
        // The first frame includes the time in which a GPU compiles its kernels.
        let others = times.get(1..).unwrap_or_default();
        if !others.is_empty() {
            let each = 1e3 * others.iter().sum::<f64>() / others.len() as f64;
            said += &format!("; {each:.1} ms each after the first, without writing");
        }
        terminal::say(&said);
        Ok(())
    }

    /// The `gaussians` of the scene `path` in the colours of their image features, if these are asked for.
    fn feature_renderer(
        &self,
        path: &Path,
        gaussians: &Gaussians,
        options: RenderOptions,
        device: &Device,
    ) -> Result<Option<Renderer>> {
        let Some(FeatureKind::Pca) = self.features else {
            return Ok(None);
        };
        let file = path.with_file_name(FEATURE_COLORS);
        ensure!(file.is_file(), argument "--features"; found "no {FEATURE_COLORS} beside {}", path.display();
            expected "a run of `coseg train` with a variant that reads image features, such as `ours`";
            help "give the run folder; scenes of `coseg edit` and of other programs have no such file");
        let colors = FeatureColors::read(&file, gaussians.len())?;
        let painted = gaussians.clone().painted(&colors.rgb);
        Renderer::new(painted, None, options, device).map(Some)
    }
}
