//! Frames of a video, by ffmpeg.

use super::program;
use crate::error::{Result, ensure};
use crate::progress::{Progress, Silent, Viewing};
use std::ffi::OsString;
use std::path::Path;
use std::process::Command;

/// What to do without ffmpeg, or where it fails.
const HELP: &str = "videos are read by ffmpeg (apt-get install ffmpeg, brew install ffmpeg); give it a video that it can play";
/// Marks each frame by how sharp it is: `YAVG` is the mean of the positive part of the Laplacian of its luma, of at most 1280 pixels
/// across.
const SHARPNESS: &str = "scale=w='min(1280,iw)':h=-2,format=yuv420p,convolution=0 -1 0 -1 4 -1 0 -1 0,signalstats,\
    metadata=print:key=lavfi.signalstats.YAVG:file=-";

/// Writes `count` frames of `video` into the empty folder `out`, `frame_0001.jpg` and so on. The video is cut into `count` windows
/// of equal length; the sharpest frame of each is taken. A video with fewer frames gives all of them.
///
/// # Errors
/// [`crate::Error::Missing`] without ffmpeg; [`crate::Error::Program`] where it fails; [`crate::Error::Input`] for a file without frames.
pub(super) fn frames(
    video: &Path,
    count: usize,
    out: &Path,
    progress: &mut dyn Progress,
) -> Result<()> {
    let mut length = Length::default();
    let mut probe = ffmpeg(video);
    probe.args(["-t", "0", "-f", "null", "-"]);
    let mut silent = Silent;
    let mut viewing = Viewing::begin(&mut silent, "video", 0);
    program::run(&mut probe, HELP, &mut viewing, |line| length.read(line))?;

    let mut sharpness: Vec<f64> = Vec::new();
    let mut measure = ffmpeg(video);
    measure.args(["-vf", SHARPNESS, "-f", "null", "-"]);
    let mut viewing = Viewing::begin(progress, "sharpness", length.frames());
    program::run(&mut measure, HELP, &mut viewing, |line| {
        let value = line.strip_prefix("lavfi.signalstats.YAVG=");
        let value: Option<f64> = value.and_then(|value| value.parse().ok());
        sharpness.extend(value);
        usize::from(value.is_some())
    })?;
    viewing.end();
    ensure!(sharpness.len() > 1, video, "frames"; found "{}", sharpness.len(); expected "two or more";
        help "give a longer video, or a folder of photos");

    let chosen = sharpest(&sharpness, count);
    // Equal times, so that ffmpeg repeats and drops none.
    let filter = format!("select='{}',setpts=N/(30*TB),showinfo", is_any_of(&chosen));
    let mut write = ffmpeg(video);
    // ffmpeg looks for patterns in the whole name, so the folder is not a part of it.
    write.current_dir(out).args(["-vf", &filter]);
    write.args(["-r", "30", "-q:v", "2", "-f", "image2", "frame_%04d.jpg"]);
    let mut viewing = Viewing::begin(progress, "frames", chosen.len());
    let is_frame = |line: &str| line.contains("showinfo") && line.contains(" pts:");
    program::run(&mut write, HELP, &mut viewing, |line| {
        usize::from(is_frame(line))
    })?;
    viewing.end();
    Ok(())
}

/// ffmpeg on the frames of `video`.
fn ffmpeg(video: &Path) -> Command {
    let mut command = Command::new("ffmpeg");
    // Without this a name may be one of a protocol.
    let mut input = OsString::from("file:");
    input.push(video);
    command.args(["-nostdin", "-hide_banner", "-nostats", "-i"]);
    command.arg(input).args(["-an", "-sn", "-dn"]);
    command
}

/// What ffmpeg says of the length of a video, for its progress.
#[derive(Default)]
struct Length {
    seconds: f64,
    rate: f64,
}

impl Length {
    /// Reads `Duration: 00:01:02.50, start: ..` and `Stream #0:0: Video: .., 29.97 fps, ..`.
    fn read(&mut self, line: &str) -> usize {
        let duration = line.strip_prefix("Duration: ").and_then(|rest| {
            let (time, _) = rest.split_once(',')?;
            let parts = time.split(':').map(str::parse::<f64>);
            parts.collect::<std::result::Result<Vec<_>, _>>().ok()
        });
        if let Some(parts) = duration {
            self.seconds = parts.iter().fold(0.0, |sum, part| 60.0 * sum + part);
        }
        let rate = line
            .split(", ")
            .find_map(|part| part.strip_suffix(" fps")?.parse().ok());
        self.rate = rate.unwrap_or(self.rate);
        0
    }

    fn frames(&self) -> usize {
        (self.seconds * self.rate).round() as usize
    }
}

/// The sharpest of each of `count` windows, as numbers of frames.
fn sharpest(sharpness: &[f64], count: usize) -> Vec<usize> {
    let frames = sharpness.len();
    let count = count.min(frames);
    let window = |i: usize| i * frames / count..(i + 1) * frames / count;
    let best = |i: usize| window(i).max_by(|a, b| sharpness[*a].total_cmp(&sharpness[*b]));
    (0..count).filter_map(best).collect()
}

/// ffmpeg's expression that is 1 for these frames. It nests sums, since ffmpeg refuses one of more than a hundred terms.
fn is_any_of(frames: &[usize]) -> String {
    match frames {
        [] => "0".to_owned(),
        [frame] => format!("eq(n,{frame})"),
        _ => {
            let (a, b) = frames.split_at(frames.len() / 2);
            format!("({}+{})", is_any_of(a), is_any_of(b))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Length, sharpest};

    #[test]
    fn each_window_gives_its_sharpest_frame() {
        let sharpness = [3.0, 1.0, 2.0, 5.0, 4.0, 0.0, 7.0];
        assert_eq!(sharpest(&sharpness, 3), [0, 3, 6]);
        assert_eq!(sharpest(&sharpness, 7), [0, 1, 2, 3, 4, 5, 6]);
        assert_eq!(sharpest(&sharpness, 100).len(), 7);
    }

    #[test]
    fn the_length_is_what_ffmpeg_says() {
        let mut length = Length::default();
        length.read("Duration: 00:01:02.50, start: 0.000000, bitrate: 1 kb/s");
        length.read(
            "Stream #0:0(und): Video: h264 (High), yuv420p, 540x960, 971 kb/s, 10 fps, 10 tbr",
        );
        assert_eq!(length.frames(), 625);
    }
}
