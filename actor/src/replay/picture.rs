//! Pictures as files: a folder of depth stills, an animated PNG, or a film that `ffmpeg` encodes.

use anyhow::{Context, Result, ensure};
use picture::{Canvas, Storyboard};
use proto::replay::{Ffmpeg, ImageFormat, ReplayImages};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

const MOMENTS_PER_SECOND: u16 = 5;
/// How much longer the last moment is shown: its caption says how the episode ended.
const LAST_MOMENT_FACTOR: u16 = 10;

pub struct Sink {
    total: usize,
    kept: usize,
    kind: Kind,
}

enum Kind {
    Stills(PathBuf),
    /// A file, open until all pictures are there, and the picture before.
    Animation(PathBuf, png::Writer<BufWriter<File>>, Option<Canvas>),
    /// A process that encodes, and the file it writes.
    Film(PathBuf, Encoder),
}

impl Sink {
    /// Makes the folder, and the file if there is to be one, for `total` pictures.
    pub fn create(images: &ReplayImages, folder: &Path, name: &str, total: usize) -> Result<Self> {
        let stills = folder.join(name);
        let made = if images.format == ImageFormat::Png { stills.as_path() } else { folder };
        std::fs::create_dir_all(made).with_context(|| format!("cannot make folder {}", made.display()))?;
        let (width, height) = Storyboard::size(images.side as usize);
        let kind = match &images.format {
            ImageFormat::Png => Kind::Stills(stills),
            ImageFormat::Apng => {
                let path = folder.join(format!("{name}.png"));
                let mut encoder = png_file(&path, width, height, png::ColorType::Rgba, png::BitDepth::Eight)?;
                encoder
                    .set_animated(total as u32, 0)
                    .and_then(|()| encoder.set_frame_delay(1, MOMENTS_PER_SECOND))
                    // A pixel that is the same as in the picture before is left transparent: that packs well.
                    .and_then(|()| encoder.set_blend_op(png::BlendOp::Over))
                    .context("cannot animate")?;
                let writer = encoder.write_header().with_context(|| format!("cannot write {}", path.display()))?;
                Kind::Animation(path, writer, None)
            }
            ImageFormat::Mp4(ffmpeg) => {
                let path = folder.join(format!("{name}.mp4"));
                let encoder = Encoder::start(ffmpeg, &path, width, height)?;
                Kind::Film(path, encoder)
            }
        };
        Ok(Self { total, kept: 0, kind })
    }

    /// Writes a depth frame, row-major, millimetres: a still.
    pub fn depth(&mut self, side: usize, depth_mm: &[u16]) -> Result<()> {
        let Kind::Stills(folder) = &self.kind else { return Ok(()) };
        let path = folder.join(format!("step-{:03}.png", self.kept));
        let failed = || format!("cannot write {}", path.display());
        let bytes: Vec<u8> = depth_mm.iter().flat_map(|depth| depth.to_be_bytes()).collect();
        let encoder = png_file(&path, side, side, png::ColorType::Grayscale, png::BitDepth::Sixteen)?;
        let mut writer = encoder.write_header().with_context(failed)?;
        writer.write_image_data(&bytes).and_then(|()| writer.finish()).with_context(failed)?;
        self.kept += 1;
        Ok(())
    }

    pub fn moment(&mut self, canvas: &Canvas) -> Result<()> {
        let last = self.kept + 1 == self.total;
        match &mut self.kind {
            Kind::Stills(_) => return Ok(()),
            Kind::Animation(path, writer, before) => {
                let failed = || format!("cannot write {}", path.display());
                if last {
                    writer.set_frame_delay(LAST_MOMENT_FACTOR, MOMENTS_PER_SECOND).with_context(failed)?;
                }
                writer.write_image_data(&changes(canvas, before.as_ref())).with_context(failed)?;
                *before = Some(canvas.clone());
            }
            Kind::Film(_, encoder) => {
                for _ in 0..if last { LAST_MOMENT_FACTOR } else { 1 } {
                    encoder.write(canvas.pixels.as_flattened())?;
                }
            }
        }
        self.kept += 1;
        Ok(())
    }

    /// Completes the file; returns the number of pictures, and a film's name.
    pub fn finish(self) -> Result<(u64, Option<String>)> {
        let path = match self.kind {
            Kind::Stills(_) => return Ok((self.kept as u64, None)),
            Kind::Animation(path, writer, _) => {
                writer.finish().with_context(|| format!("cannot complete {}", path.display()))?;
                path
            }
            Kind::Film(path, encoder) => {
                encoder.finish(&path)?;
                path
            }
        };
        Ok((self.kept as u64, path.file_name().map(|name| name.to_string_lossy().into_owned())))
    }
}

/// The picture as RGBA; what is as in the one before is transparent.
fn changes(canvas: &Canvas, before: Option<&Canvas>) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(canvas.pixels.len() * 4);
    for (index, &[r, g, b]) in canvas.pixels.iter().enumerate() {
        let same = before.is_some_and(|before| before.pixels[index] == [r, g, b]);
        bytes.extend(if same { [0; 4] } else { [r, g, b, 255] });
    }
    bytes
}

struct Encoder {
    child: Child,
}

impl Encoder {
    fn start(ffmpeg: &Ffmpeg, path: &Path, width: usize, height: usize) -> Result<Self> {
        let (size, rate) = (format!("{width}x{height}"), MOMENTS_PER_SECOND.to_string());
        let child = Command::new(&ffmpeg.program)
            .args(["-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", &size, "-r", &rate])
            .args(["-i", "-", "-c:v", &ffmpeg.encoder, "-pix_fmt", "yuv420p", "-movflags", "+faststart"])
            .arg(path)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .spawn()
            .with_context(|| format!("cannot start {}", ffmpeg.program))?;
        Ok(Self { child })
    }

    fn write(&mut self, bytes: &[u8]) -> Result<()> {
        let input = self.child.stdin.as_mut().context("ffmpeg has no standard input")?;
        input.write_all(bytes).context("ffmpeg takes no more pictures; its last messages are above")
    }

    fn finish(mut self, path: &Path) -> Result<()> {
        // The end of its input.
        drop(self.child.stdin.take());
        let status = self.child.wait().context("cannot wait for ffmpeg")?;
        ensure!(status.success(), "ffmpeg did not write {}: {status}; its last messages are above", path.display());
        Ok(())
    }
}

impl Drop for Encoder {
    fn drop(&mut self) {
        // After a failure; a process that has ended is left alone.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn png_file(
    path: &Path,
    width: usize,
    height: usize,
    colour: png::ColorType,
    depth: png::BitDepth,
) -> Result<png::Encoder<'static, BufWriter<File>>> {
    let file = File::create(path).with_context(|| format!("cannot create {}", path.display()))?;
    let mut encoder = png::Encoder::new(BufWriter::new(file), width as u32, height as u32);
    encoder.set_color(colour);
    encoder.set_depth(depth);
    Ok(encoder)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn images(folder: &Path, format: ImageFormat) -> ReplayImages {
        ReplayImages { folder: folder.join("new").display().to_string(), format, side: 40 }
    }

    fn decoder(path: &Path) -> png::Reader<std::io::BufReader<File>> {
        png::Decoder::new(std::io::BufReader::new(File::open(path).unwrap())).read_info().unwrap()
    }

    #[test]
    fn a_still_holds_the_millimetres() {
        let folder = tempfile::tempdir().unwrap();
        let new = folder.path().join("new");
        let mut sink = Sink::create(&images(folder.path(), ImageFormat::Png), &new, "episode", 1).unwrap();
        let depths = [0u16, 1, 255, 256, 1000, 2000, 3000, 30000, 32766];
        sink.depth(3, &depths).unwrap();
        assert_eq!(sink.finish().unwrap(), (1, None));
        let mut reader = decoder(&new.join("episode/step-000.png"));
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut bytes).unwrap();
        assert_eq!((info.width, info.height, info.bit_depth), (3, 3, png::BitDepth::Sixteen));
        let read: Vec<u16> = bytes.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect();
        assert_eq!(read, depths);
    }

    #[test]
    fn an_animation_holds_every_picture_and_of_each_what_has_changed() {
        let folder = tempfile::tempdir().unwrap();
        let new = folder.path().join("new");
        let mut sink = Sink::create(&images(folder.path(), ImageFormat::Apng), &new, "episode", 3).unwrap();
        let (width, height) = Storyboard::size(40);
        let mut canvas = Canvas::new(width, height, [9, 9, 9]);
        for index in 0..3 {
            canvas.pixels[index] = [200, 0, 0];
            sink.moment(&canvas).unwrap();
        }
        assert_eq!(sink.finish().unwrap(), (3, Some("episode.png".to_owned())));
        let mut reader = decoder(&new.join("episode.png"));
        assert_eq!(reader.info().animation_control().unwrap().num_frames, 3);
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        for (frame, opaque) in [(0, width * height), (1, 1), (2, 1)] {
            reader.next_frame(&mut bytes).unwrap();
            assert_eq!(bytes.chunks_exact(4).filter(|pixel| pixel[3] == 255).count(), opaque, "frame {frame}");
            assert_eq!(bytes[4 * frame..4 * frame + 4], [200, 0, 0, 255]);
        }
    }

    #[test]
    fn an_encoder_that_cannot_be_started_or_fails_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let film = |program: &str| {
            let ffmpeg = Ffmpeg { program: program.to_owned(), encoder: "libx264".to_owned() };
            let images = images(folder.path(), ImageFormat::Mp4(ffmpeg));
            Sink::create(&images, &folder.path().join("new"), "episode", 1).and_then(Sink::finish)
        };
        assert!(film("/no/ffmpeg").unwrap_err().to_string().contains("cannot start /no/ffmpeg"));
        assert!(film("false").unwrap_err().to_string().contains("ffmpeg did not write"));
    }
}
