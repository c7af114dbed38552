//! `coseg query`: finds what a text describes in a scene, by image features of CLIP.

use super::export::safe;
use super::frame_files::{Format, FrameFiles, write_npy};
use super::object_scene::EditedSceneArgs;
use super::{BackendArgs, Settings, terminal, values};
use clap::{Args, ValueEnum};
use coseg::backend::device::open_cpu;
use coseg::config::{Config, FeatureSource};
use coseg::data::{LoadOptions, NamedCamera, Split, check_outputs};
use coseg::error::{Error, Result, bail, ensure};
use coseg::features::Activation;
use coseg::features::clip::{TextEncoder, Tokenizer};
use coseg::files::own;
use coseg::objects::{
    CANONICAL, NEUTRAL, RenderOptions, Renderer, best_scale, largest, selections,
};
use coseg::pipeline::{LiftedMaps, compare_with_photos, load_scene};
use coseg::runs::{CAMERAS, CONFIG, Cameras, ObjectScene, named_frame};
use glam::DVec3;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Where lifted features are kept in the output folder.
const LIFTED: &str = "lifted";
/// Lifted features that are in memory at once, bytes.
const LIFTED_BYTES: usize = 1 << 29;

const HELP: &str = "\
Lifts feature maps in the space of CLIP (of LSeg, OpenSeg or CLIP itself, all channels) onto the Gaussians, and compares
them with texts as LERF does: the relevancy of a Gaussian is the share of --text in a softmax with each --negative, the
smallest of these shares. 0.5 means neither. For each text, the scale with the highest relevancy is used.

The Gaussians above --threshold become an object with the text as its name, as with `coseg select`. Where several texts
apply, the most relevant one counts. For each text TEXT the output folder gets
  scene.ply, classes.json, cameras.json   the scene with these objects
  TEXT/relevancy.npy                      [N] float32, in the order of scene.ply; 0 for Gaussians without features
  TEXT/STEM.relevancy.png                 held-out views, or those of --frame: grey up to 0.5, bright at the largest relevancy of a
                                          Gaussian; npy: [H, W] float32, the mean of what a pixel shows
  lifted/                                 the lifted features, for the next query; features.cache_dir is used instead if it is set

Weights have the names of Hugging Face (model.safetensors) or of OpenCLIP. They must belong to the image features: most models of
LSeg have ViT-B/32 of OpenAI (quick-gelu), LERF and LangSplat have ViT-B/16 of OpenCLIP on LAION (--activation gelu). No published
weights were at hand when this was written: it ran with random ones.

Examples:
  coseg query --scene runs/room --features lseg --weights clip.safetensors --text \"a red chair\" --out found
  coseg query --scene point_cloud.ply --data room --features lseg --weights clip.safetensors --text lamp --text sofa --out found
  coseg export --scene found --out parts --only \"a red chair\"";

/// Arguments of `coseg query`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct QueryArgs {
    #[command(flatten)]
    scene: EditedSceneArgs,
    /// Scene folder: photos and cameras [default: that of the run]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Folder of feature maps, of one to four scales each [default: that of the run]
    #[arg(long, value_name = "DIR")]
    features: Option<PathBuf>,
    /// Weights of CLIP's text encoder, or of all of CLIP
    #[arg(long, value_name = "FILE")]
    weights: PathBuf,
    /// Nonlinearity of the text encoder [default: that of config.json beside the weights, or else quick-gelu]
    #[arg(long, value_enum)]
    activation: Option<ActivationArg>,
    /// What to look for; may be repeated
    #[arg(long = "text", value_name = "TEXT", required = true, value_parser = values::name)]
    texts: Vec<String>,
    /// What it is compared with; may be repeated [default: object, things, stuff, texture]
    #[arg(long = "negative", value_name = "TEXT", value_parser = values::name)]
    negatives: Vec<String>,
    /// Relevancy above which Gaussians are selected, 0 to 1
    #[arg(long, value_name = "T", default_value_t = NEUTRAL, value_parser = values::share, allow_negative_numbers = true)]
    threshold: f32,
    /// View to draw, by its name or the path of its photo; may be repeated [default: the held-out views]
    #[arg(long = "frame", value_name = "STEM")]
    frames: Vec<String>,
    /// Kind of files of the views
    #[arg(long, value_enum, default_value_t = Format::Png)]
    format: Format,
    #[command(flatten)]
    backend: BackendArgs,
    #[command(flatten)]
    settings: Settings,
}

/// Nonlinearities of published text encoders.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ActivationArg {
    QuickGelu,
    Gelu,
}

impl QueryArgs {
    /// Lifts, compares, selects and writes.
    pub fn run(self) -> Result<()> {
        let scene = self.scene.from.read_or_unlabelled()?;
        let config = self.config(&scene.path)?;
        let folder = self.folder(&config)?;
        self.check(&config)?;
        self.scene.file(&scene, &scene.classes)?;
        let phrases = self.phrases()?;
        for (text, name) in self.texts.iter().enumerate() {
            ensure!(!self.others(text, &phrases).is_empty(), argument "--negative"; found "{name}, which is a --text";
                expected "a phrase to compare it with"; help "give another one, or none");
        }
        let photos = load_scene(&config)?.with_origin(scene.ply.origin);
        let all = photos.cameras();
        let shown = self.shown(&all, photos.origin)?;
        let device = self.backend.open()?;
        let gaussians = &scene.ply.gaussians;
        compare_with_photos(&scene.path, gaussians, &photos, &config, &device)?;
        let cache = self.scene.folder().join(LIFTED);
        let lifted = LiftedMaps {
            folder,
            scene: &photos,
            gaussians,
            config: &config,
            cache: config.features.cache_dir.as_deref().unwrap_or(&cache),
            device: &device,
            most_bytes: LIFTED_BYTES,
        };
        let bar = terminal::bar("lifting", 0);
        let similarities = lifted.similarities(&phrases, &mut |done, all| {
            bar.set_length(all as u64);
            bar.set_position(done as u64);
        })?;
        bar.finish_and_clear();
        let relevancy = |text: usize| {
            let others = self.others(text, &phrases);
            best_scale(&similarities, text, &others)
        };
        let relevancies: Vec<Vec<f32>> = (0..self.texts.len()).map(relevancy).collect();
        let of_run = self.data.is_none() && scene.path.with_file_name(CAMERAS).is_file();
        let cameras = if of_run {
            Cameras::Beside(&scene.path)
        } else {
            Cameras::Used(&all)
        };
        self.write(&scene, &relevancies, cameras)?;
        let options = RenderOptions::from(&config);
        let renderer = Renderer::new(gaussians.clone(), None, options, &device)?;
        self.draw(&renderer, &shown, &relevancies)
    }

    /// The settings given, or else those of the run that the scene `path` belongs to, with what the options say.
    fn config(&self, path: &Path) -> Result<Config> {
        let beside = path.with_file_name(CONFIG);
        let mut settings = self.settings.clone();
        if settings.config.is_none() && beside.is_file() {
            settings.config = Some(beside);
        }
        let mut config = settings.load(self.data.as_ref())?;
        let is_of_run = self.settings.config.is_none() && settings.config.is_some();
        ensure!(config.data.dir.is_some() || is_of_run, argument "--data"; found "nothing";
            expected "the scene folder, as {} is in no run folder", path.display(); help "give the folder of the photos");
        if let Some(folder) = &self.features {
            config.features.source = FeatureSource::Import(folder.clone());
        }
        Ok(config)
    }

    /// The folder of the maps.
    fn folder<'a>(&self, config: &'a Config) -> Result<&'a Path> {
        let FeatureSource::Import(folder) = &config.features.source else {
            bail!(argument "--features"; found "nothing"; expected "a folder of feature maps";
                help "give it, or a run with features.source.import; features of other sources cannot be compared with a text");
        };
        let help = "give the folder of the feature maps";
        if !folder.is_dir() {
            return Err(Error::missing("folder", folder, help));
        }
        Ok(folder)
    }

    /// Refuses texts that would share a folder, and outputs that would harm the scene folder.
    fn check(&self, config: &Config) -> Result<()> {
        let names: Vec<String> = self.texts.iter().map(|text| safe(text)).collect();
        // Some file systems ignore case.
        let different: BTreeSet<String> = names.iter().map(|name| name.to_lowercase()).collect();
        ensure!(different.len() == names.len() && !different.contains(LIFTED), argument "--text"; found "{}", self.texts.join(", ");
            expected "texts that differ in the letters and digits of their first 50 characters, and none called {LIFTED}";
            help "leave one out");
        let out = self.scene.folder();
        let folders: Vec<PathBuf> = names.iter().map(|name| out.join(name)).collect();
        let lifted = out.join(LIFTED);
        let all = folders.iter().chain([&lifted]).map(PathBuf::as_path);
        let all: Vec<&Path> = all.collect();
        let options = LoadOptions::from(config);
        let scene = config.data.dir.as_deref().map(|dir| (dir, &options));
        check_outputs("--out", &all, scene)?;
        folders.iter().try_for_each(own::check_folder)
    }

    /// The embeddings of the texts, then of what they are compared with, all of length 1.
    fn phrases(&self) -> Result<Vec<Vec<f32>>> {
        let device = open_cpu()?;
        let encoder = TextEncoder::load(&self.weights, &device)?;
        let tokenizer = Tokenizer::new();
        let (found, expected) = (encoder.vocabulary(), tokenizer.vocabulary());
        ensure!(found == expected, &self.weights, "token embeddings"; found "{found}"; expected "{expected}, the vocabulary of CLIP";
            help "give weights of CLIP");
        let activation = self.activation()?;
        let canonical = CANONICAL.map(str::to_owned);
        let negatives = match &self.negatives[..] {
            [] => &canonical,
            negatives => negatives,
        };
        let embedding = |text: &String| {
            let tokens = tokenizer.tokens(text);
            let most = encoder.most_tokens();
            ensure!(tokens.len() <= most, argument "--text, --negative"; found "{text}, {} tokens with its two ends", tokens.len();
                expected "at most {most}"; help "give a shorter text");
            let embedding = encoder.embedding(&tokens, activation)?;
            let square: f64 = embedding.iter().map(|v| f64::from(*v).powi(2)).sum();
            ensure!(square > 0.0, &self.weights, "text embedding"; found "zeros for {text}"; expected "a direction";
                help "give weights of CLIP");
            let scale = square.sqrt().recip();
            let scaled = |v: &f32| (scale * f64::from(*v)) as f32;
            Ok(embedding.iter().map(scaled).collect())
        };
        self.texts.iter().chain(negatives).map(embedding).collect()
    }

    /// The nonlinearity that is asked for, or else that of the configuration beside the weights.
    fn activation(&self) -> Result<Activation> {
        match self.activation {
            Some(ActivationArg::QuickGelu) => return Ok(Activation::QuickGelu),
            Some(ActivationArg::Gelu) => return Ok(Activation::Gelu),
            None => {}
        }
        let named = TextEncoder::activation_beside(&self.weights)?;
        if named.is_none() {
            terminal::note(
                "note: no config.json is beside the weights; --activation quick-gelu, OpenAI's, is assumed",
            );
        }
        Ok(named.unwrap_or(Activation::QuickGelu))
    }

    /// The phrases that text number `text` is compared with. A text that is a negative too is not compared with itself.
    fn others(&self, text: usize, phrases: &[Vec<f32>]) -> Vec<usize> {
        let others = self.texts.len()..phrases.len();
        others
            .filter(|&other| phrases[other] != phrases[text])
            .collect()
    }

    /// Those of the cameras `all` that are drawn, relative to `origin`.
    fn shown(&self, all: &[NamedCamera], origin: DVec3) -> Result<Vec<NamedCamera>> {
        let mut all = all.to_vec();
        for view in &mut all {
            view.camera = view.camera.moved(-origin);
        }
        if self.frames.is_empty() {
            all.retain(|view| view.split == Split::Test);
            if all.is_empty() {
                terminal::note("note: no held-out view to draw; --frame names others");
            }
            return Ok(all);
        }
        let frames = self.frames.iter();
        frames
            .map(|frame| named_frame(&all, frame).cloned())
            .collect()
    }

    /// Writes the relevancy of each Gaussian to each text, and the scene with an object for each text.
    fn write(&self, scene: &ObjectScene, relevancies: &[Vec<f32>], cameras: Cameras) -> Result<()> {
        let selections = selections(relevancies, self.threshold);
        let objects = self.texts.iter().zip(&selections);
        let objects: Vec<(&str, &[u32])> = objects
            .map(|(text, rows)| (text.as_str(), &rows[..]))
            .collect();
        let (ids, edited) = scene.named(&objects, "--text")?;
        let out = self.scene.write(scene, &edited, cameras)?;
        for (((text, rows), id), relevancy) in objects.iter().zip(ids).zip(relevancies) {
            let folder = self.scene.folder().join(safe(text));
            write_npy(&folder.join("relevancy.npy"), &[relevancy.len()], relevancy)?;
            let most = largest(relevancy);
            let selected = match id {
                Some(id) => format!(
                    "{} of {} Gaussians are now {text} (label {id})",
                    rows.len(),
                    relevancy.len()
                ),
                None => format!("no Gaussian is {text}"),
            };
            terminal::say(&format!(
                "{}: {selected}; threshold {}, largest relevancy {most:.3}",
                out.display(),
                self.threshold
            ));
        }
        Ok(())
    }

    /// Draws the relevancy of each text in each view.
    fn draw(
        &self,
        renderer: &Renderer,
        cameras: &[NamedCamera],
        relevancies: &[Vec<f32>],
    ) -> Result<()> {
        for NamedCamera { name, camera, .. } in cameras {
            let frame = renderer.frame(camera)?;
            for (text, relevancy) in self.texts.iter().zip(relevancies) {
                let files = FrameFiles {
                    folder: &self.scene.folder().join(safe(text)),
                    name,
                    format: self.format,
                };
                let shown = renderer.mean(camera, relevancy)?;
                files.write_relevancy(&shown, [NEUTRAL, largest(relevancy)], &frame)?;
            }
        }
        Ok(())
    }
}
