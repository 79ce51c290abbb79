//! The gRPC peer's service, without a .proto file or protoc.

use tonic_build::manual::{Builder, Method, Service};

fn main() {
    let exchange = Method::builder()
        .name("exchange")
        .route_name("Exchange")
        .input_type("crate::ways::grpc::Observations")
        .output_type("crate::ways::grpc::Actions")
        .codec_path("tonic_prost::ProstCodec")
        .client_streaming()
        .server_streaming()
        .build();
    let service = Service::builder().name("Exchange").package("bench").method(exchange).build();
    Builder::new().compile(&[service]);
}
