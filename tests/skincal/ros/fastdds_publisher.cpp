// A publisher on Fast DDS, the default middleware of ROS 2: wrenches on the loopback interface, reliable as ROS publishes them.
// fastdds_publisher DOMAIN HZ COUNT: waits for a reader, then publishes COUNT wrenches on /ft/wrench and waits to be killed.
#include <chrono>
#include <cstdlib>
#include <iostream>
#include <thread>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/core/status/PublicationMatchedStatus.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>

#include "fastdds_wrenchPubSubTypes.h"

using namespace eprosima::fastdds::dds;
using namespace std::chrono;

int main(int, char** argv)
{
    DomainParticipantQos participant_qos;
    auto loopback = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    loopback->interfaceWhiteList.push_back("127.0.0.1");
    participant_qos.transport().use_builtin_transports = false;
    participant_qos.transport().user_transports.push_back(loopback);
    auto* participant = DomainParticipantFactory::get_instance()->create_participant(std::atoi(argv[1]), participant_qos);
    TypeSupport type(new geometry_msgs::msg::WrenchStampedPubSubType());
    type->setName("geometry_msgs::msg::dds_::WrenchStamped_");
    type.register_type(participant);
    auto* topic = participant->create_topic("rt/ft/wrench", type.get_type_name(), TOPIC_QOS_DEFAULT);
    auto* publisher = participant->create_publisher(PUBLISHER_QOS_DEFAULT);
    DataWriterQos qos;
    qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
    qos.history().kind = KEEP_LAST_HISTORY_QOS;
    qos.history().depth = 10;
    auto* writer = publisher->create_datawriter(topic, qos);
    PublicationMatchedStatus matched;
    while (writer->get_publication_matched_status(matched) == ReturnCode_t::RETCODE_OK && matched.current_count < 1)
        std::this_thread::sleep_for(milliseconds(20));
    // Discovery of the writer by the reader ends a little later than that of the reader by the writer.
    std::this_thread::sleep_for(seconds(2));
    const auto period = duration_cast<steady_clock::duration>(duration<double>(1.0 / std::atof(argv[2])));
    auto next = steady_clock::now();
    for (int number = 1; number <= std::atoi(argv[3]); ++number)
    {
        geometry_msgs::msg::WrenchStamped sample;
        const auto now = duration_cast<nanoseconds>(system_clock::now().time_since_epoch()).count();
        sample.header().stamp().sec(static_cast<int32_t>(now / 1000000000));
        sample.header().stamp().nanosec(static_cast<uint32_t>(now % 1000000000));
        sample.header().frame_id("ft");
        sample.wrench_().force().x(number);
        sample.wrench_().torque().z(-0.5);
        writer->write(&sample);
        next += period;
        std::this_thread::sleep_until(next);
    }
    std::cout << "sent" << std::endl;
    std::this_thread::sleep_for(hours(1));
}
