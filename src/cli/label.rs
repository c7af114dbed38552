//! `coseg label`: label maps and scores from photos, by a 2D segmenter.

use super::progress::Bars;
use super::{Settings, interrupt, terminal};
use clap::Args;
use coseg::data::{LoadOptions, check_outputs};
use coseg::error::{Error, Result, ensure};
use coseg::files::lock::locked;
use coseg::files::shell_word;
use coseg::segmenter::{ClassFile, Contract, Job, Labelled, Network, label_scene};
use std::path::{Path, PathBuf};

/// Classes that the scores of a cell keep.
pub const BEST: usize = 5;

const HELP: &str = "\
Runs a semantic segmenter in an ONNX file over all photos of a scene folder, train and test. Writes into a new folder
  NAME.png        the label map of each photo, grey, 0 is unlabelled
  scores/         the best classes of each place with their probabilities
  classes.json    id, name and colour of each class
  geometry.json   says that the maps belong to the photos as they are stored
  label.json      what was written, and from what; the same command continues, and keeps labels that were made from the same
                  network, contract, classes and photo

The contract says how the network reads photos and what its output means. --contract names it; otherwise it is FILE.toml
beside FILE.onnx, or the built-in contract with the model's name. docs/data.md describes it.

--classes names the classes of the labels, a TOML with lists of the network's classes:
  [classes]
  sofa = [\"sofa\", \"armchair\"]
  floor = [\"floor\", \"rug\"]
Where the scene has a classes.json, the names on the left are its own. The network's other classes are dropped. Without
--classes, the labels have those of the network's classes that occur.

Examples:
  coseg label --data scenes/living --model deeplab_mnv2_ade20k.onnx --out labels/living
  coseg label --data scenes/living --model net.onnx --contract segformer_ade20k --classes mine.toml --out labels/living
  coseg data info scenes/living --sheet sheet.png --set data.raw_labels=$PWD/labels/living
  coseg train --data scenes/living --set data.raw_labels=$PWD/labels/living
  coseg train --data scenes/living --segmenter deeplab_mnv2_ade20k.onnx          all in one command";

/// Arguments of `coseg label`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct LabelArgs {
    /// Scene folder with photos and cameras
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// The segmenter
    #[arg(long, visible_alias = "segmenter", value_name = "FILE.onnx")]
    model: PathBuf,
    #[command(flatten)]
    segmenter: SegmenterArgs,
    /// Folder to write; new, or one that this command wrote
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Classes of each place that the scores keep, 1 to 255
    #[arg(long, value_name = "N", default_value_t = BEST as u8, value_parser = clap::value_parser!(u8).range(1..))]
    best: u8,
    #[command(flatten)]
    settings: Settings,
}

/// How a segmenter is used.
#[derive(Args, Debug, Default)]
pub struct SegmenterArgs {
    /// How the network reads photos: a TOML or a shipped contract [default: the model's name]
    #[arg(long, value_name = "FILE|NAME")]
    pub contract: Option<String>,
    /// The classes of the labels, a TOML [default: those of the network that occur]
    #[arg(long, value_name = "FILE.toml")]
    classes: Option<PathBuf>,
}

impl SegmenterArgs {
    /// Labels the scene folder `dir`.
    pub fn label(
        &self,
        (dir, options): (&Path, &LoadOptions),
        model: &Path,
        best: usize,
        out: &Path,
    ) -> Result<Labelled> {
        if !model.is_file() {
            let help = "give the ONNX file of a semantic segmenter";
            return Err(Error::missing("file", model, help));
        }
        // The quick checks first.
        let contract = Contract::find(model, self.contract.as_deref())?;
        let classes = self.classes.as_deref().map(ClassFile::read).transpose()?;
        let network = Network::load(model, contract)?;
        check_outputs("--out", &[out], Some((dir, options)))?;
        let job = Job {
            dir,
            options,
            network: &network,
            classes: classes.as_ref(),
            best,
            out,
        };
        locked(out, || label_scene(&job, &mut Bars::default()))
    }

    /// Refuses options of a segmenter that is not there.
    pub fn expect_none(&self) -> Result<()> {
        ensure!(self.contract.is_none() && self.classes.is_none(),
            argument "--contract, --classes"; found "no segmenter";
            expected "--segmenter FILE.onnx, to which they belong"; help "name it, or leave them out");
        Ok(())
    }
}

impl LabelArgs {
    /// Labels the photos.
    pub fn run(self) -> Result<()> {
        let config = self.settings.load(Some(&self.data))?;
        let options = LoadOptions::from(&config);
        interrupt::watch(interrupt::SAME_COMMAND);
        let scene = (self.data.as_path(), &options);
        let best = usize::from(self.best);
        let done = self.segmenter.label(scene, &self.model, best, &self.out)?;
        let folder = shell_word(self.out.canonicalize().unwrap_or(self.out.clone()));
        terminal::say(&format!(
            "{}: {} photos, {} labelled before; {} classes; use it with --set data.raw_labels={folder}",
            self.out.display(),
            done.photos,
            done.cached,
            done.classes,
        ));
        Ok(())
    }
}
