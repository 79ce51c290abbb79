//! Depth frames as PNG files: 16-bit stills, or one animated picture an episode.

use anyhow::{Context, Result};
use proto::replay::{ImageFormat, RecordedEpisode, ReplayImages};
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

/// Depth that is drawn black in an animated picture, millimetres.
const BLACK_MM: u32 = 5_000;
/// Frames a second of an animated picture.
const FRAMES_PER_SECOND: u16 = 10;

/// Where the pictures of one episode go.
pub struct Pictures {
    side: usize,
    depth_mm: Vec<u16>,
    bytes: Vec<u8>,
    kept: u64,
    sink: Sink,
}

enum Sink {
    /// A folder of stills.
    Stills(PathBuf),
    /// A file, open until all frames are there.
    Animation(PathBuf, png::Writer<BufWriter<File>>),
}

/// A frame to be rendered into.
pub struct Frame<'a> {
    /// Width and height, pixels.
    pub side: usize,
    /// Row-major from the top left, millimetres.
    pub depth_mm: &'a mut [u16],
}

impl Pictures {
    /// Makes the folder, and the file if there is to be one.
    pub fn begin(images: &ReplayImages, recorded: &RecordedEpisode) -> Result<Self> {
        let id = recorded.environment;
        let name =
            format!("kitchen-{:02}-environment-{}-episode-{:06}", id.kitchen.number(), id.number, recorded.episode);
        let path = Path::new(&images.folder).join(name);
        let sink = match images.format {
            ImageFormat::Png => {
                std::fs::create_dir_all(&path).with_context(|| format!("cannot make folder {}", path.display()))?;
                Sink::Stills(path)
            }
            ImageFormat::Video => {
                std::fs::create_dir_all(&images.folder)
                    .with_context(|| format!("cannot make folder {}", images.folder))?;
                let path = path.with_extension("png");
                let mut encoder = encoder(&path, images.side, png::BitDepth::Eight)?;
                let frames = recorded.actions.len() as u32 + 1;
                encoder
                    .set_animated(frames, 0)
                    .and_then(|()| encoder.set_frame_delay(1, FRAMES_PER_SECOND))
                    .context("cannot animate")?;
                let writer = encoder.write_header().with_context(|| format!("cannot write {}", path.display()))?;
                Sink::Animation(path, writer)
            }
        };
        let side = images.side as usize;
        Ok(Self { side, depth_mm: vec![0; side * side], bytes: Vec::new(), kept: 0, sink })
    }

    /// The frame to render into next.
    pub fn frame(&mut self) -> Frame<'_> {
        Frame { side: self.side, depth_mm: &mut self.depth_mm }
    }

    /// Writes the frame that was rendered.
    pub fn keep(&mut self) -> Result<()> {
        self.bytes.clear();
        match &mut self.sink {
            Sink::Stills(folder) => {
                self.bytes.extend(self.depth_mm.iter().flat_map(|depth| depth.to_be_bytes()));
                let path = folder.join(format!("step-{:03}.png", self.kept));
                let failed = || format!("cannot write {}", path.display());
                let mut writer =
                    encoder(&path, self.side as u32, png::BitDepth::Sixteen)?.write_header().with_context(failed)?;
                writer.write_image_data(&self.bytes).with_context(failed)?;
                writer.finish().with_context(failed)?;
            }
            Sink::Animation(path, writer) => {
                self.bytes.extend(self.depth_mm.iter().map(|&depth| brightness(depth)));
                writer.write_image_data(&self.bytes).with_context(|| format!("cannot write {}", path.display()))?;
            }
        }
        self.kept += 1;
        Ok(())
    }

    /// Completes the file; returns the number of frames.
    pub fn finish(self) -> Result<u64> {
        if let Sink::Animation(path, writer) = self.sink {
            writer.finish().with_context(|| format!("cannot complete {}", path.display()))?;
        }
        Ok(self.kept)
    }
}

/// Near is bright; nothing, and everything far, is black.
fn brightness(depth_mm: u16) -> u8 {
    match u32::from(depth_mm) {
        0 => 0,
        depth => (255 * BLACK_MM.saturating_sub(depth) / BLACK_MM) as u8,
    }
}

fn encoder(path: &Path, side: u32, depth: png::BitDepth) -> Result<png::Encoder<'static, BufWriter<File>>> {
    let file = File::create(path).with_context(|| format!("cannot create {}", path.display()))?;
    let mut encoder = png::Encoder::new(BufWriter::new(file), side, side);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(depth);
    Ok(encoder)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::episode::EnvironmentId;
    use proto::kitchen::KitchenId;

    fn episode(actions: usize) -> RecordedEpisode {
        RecordedEpisode {
            environment: EnvironmentId { kitchen: KitchenId::new(3).unwrap(), number: 1 },
            episode: 4,
            start_hash: None,
            actions: vec![0; actions],
            hashes: vec![0; actions],
        }
    }

    fn images(folder: &Path, format: ImageFormat) -> ReplayImages {
        ReplayImages { folder: folder.join("new").display().to_string(), format, side: 3 }
    }

    #[test]
    fn a_still_holds_the_millimetres() {
        let folder = tempfile::tempdir().unwrap();
        let mut pictures = Pictures::begin(&images(folder.path(), ImageFormat::Png), &episode(0)).unwrap();
        let depths = [0u16, 1, 255, 256, 1000, 2000, 3000, 30000, 32766];
        pictures.frame().depth_mm.copy_from_slice(&depths);
        pictures.keep().unwrap();
        assert_eq!(pictures.finish().unwrap(), 1);
        let path = folder.path().join("new/kitchen-03-environment-1-episode-000004/step-000.png");
        let mut reader = png::Decoder::new(std::io::BufReader::new(File::open(path).unwrap())).read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut bytes).unwrap();
        assert_eq!((info.width, info.height, info.bit_depth), (3, 3, png::BitDepth::Sixteen));
        let read: Vec<u16> = bytes.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect();
        assert_eq!(read, depths);
    }

    #[test]
    fn an_animation_holds_every_frame() {
        let folder = tempfile::tempdir().unwrap();
        let mut pictures = Pictures::begin(&images(folder.path(), ImageFormat::Video), &episode(2)).unwrap();
        for depth in [0u16, 100, 6000] {
            pictures.frame().depth_mm.fill(depth);
            pictures.keep().unwrap();
        }
        assert_eq!(pictures.finish().unwrap(), 3);
        let path = folder.path().join("new/kitchen-03-environment-1-episode-000004.png");
        let mut reader = png::Decoder::new(std::io::BufReader::new(File::open(path).unwrap())).read_info().unwrap();
        assert_eq!(reader.info().animation_control().unwrap().num_frames, 3);
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        for expected in [0, 249, 0] {
            reader.next_frame(&mut bytes).unwrap();
            assert!(bytes.iter().all(|&byte| byte == expected), "{bytes:?}");
        }
    }
}
